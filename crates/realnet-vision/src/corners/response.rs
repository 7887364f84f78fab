//! The corner response, computed row by row from 8-bit pixels.

use crate::pyramid::{Level, reflect};
use crate::simd::{Simd, multiversion};

/// From the response of integer gradients to that of OpenCV's scaled ones:
/// Sobel sums by 1/4, the block by 1/3 and pixels by 1/255, squared.
pub(super) const UNIT: f32 = 1.0 / (3060.0 * 3060.0);

/// The rows that are in work: gradients and responses of three rows each.
#[derive(Clone, Debug, Default)]
pub(super) struct ResponseRows {
    width: usize,
    /// Horizontal gradients of rows y mod 3, one column more on each side.
    dx: [Vec<i16>; 3],
    /// Vertical gradients.
    dy: [Vec<i16>; 3],
    /// Gradients up to this row are there.
    ready: usize,
    /// Moments xx, xy, yy summed over three rows.
    moments: [Vec<i32>; 3],
    /// Responses of rows y mod 3 as the bits of non-negative floats.
    responses: [Vec<u32>; 3],
    /// 1 where a row has a local maximum.
    flags: Vec<u8>,
}

impl ResponseRows {
    /// Prepares for a picture of this width.
    pub(super) fn start(&mut self, width: usize) {
        self.ready = 0;
        if self.width != width {
            self.width = width;
            self.dx.iter_mut().chain(&mut self.dy).for_each(|row| row.resize(width + 2, 0));
            self.moments.iter_mut().for_each(|row| row.resize(width + 2, 0));
            self.responses.iter_mut().for_each(|row| row.resize(width, 0));
            self.flags.clear();
            self.flags.resize(width.next_multiple_of(8), 0);
        }
    }

    /// Computes the responses of row `y`, the one after the last, and returns
    /// the bits of the greatest where the mask allows.
    pub(super) fn advance(
        &mut self,
        simd: Simd,
        level: &Level,
        y: usize,
        mask: Option<&[u8]>,
    ) -> u32 {
        let height = level.height() as usize;
        while self.ready < (y + 2).min(height) {
            self.gradients(simd, level, self.ready);
            self.ready += 1;
        }
        // Moments, not gradients, are mirrored at the border: OpenCV's box filter.
        let rows = [y as isize - 1, y as isize, y as isize + 1].map(|y| reflect(y, height) % 3);
        let [xx, xy, yy] = &mut self.moments;
        let (dx, dy) = (rows.map(|r| &self.dx[r][..]), rows.map(|r| &self.dy[r][..]));
        sum_moments(simd, dx, dy, xx, xy, yy);
        let out = &mut self.responses[y % 3];
        let best = respond(simd, xx, xy, yy, out);
        match mask {
            None => best,
            Some(mask) => out.iter().zip(mask).filter(|(_, m)| **m != 0).map(|(v, _)| *v).max(),
        }
        .unwrap_or(0)
    }

    /// Calls `found` with column and response bits of each local maximum of row
    /// `y` above `threshold`; rows `y - 1` to `y + 1` must be there.
    pub(super) fn maxima(
        &mut self,
        simd: Simd,
        y: usize,
        threshold: u32,
        mask: Option<&[u8]>,
        mut found: impl FnMut(usize, u32),
    ) {
        if self.width < 3 {
            return;
        }
        let [up, middle, down] = [y + 2, y, y + 1].map(|y| &self.responses[y % 3][..]);
        if flag_maxima(simd, up, middle, down, threshold, &mut self.flags) == 0 {
            return;
        }
        for (chunk, flags) in self.flags.as_chunks::<8>().0.iter().enumerate() {
            let mut bits = u64::from_le_bytes(*flags);
            while bits != 0 {
                let x = chunk * 8 + bits.trailing_zeros() as usize / 8;
                bits &= bits - 1;
                if mask.is_none_or(|mask| mask[x] != 0) {
                    found(x, middle[x]);
                }
            }
        }
    }

    fn gradients(&mut self, simd: Simd, level: &Level, y: usize) {
        let (width, y) = (self.width, y as isize);
        let rows = [y - 1, y, y + 1].map(|y| {
            let row = level.padded_row(y);
            &row[level.border() - 1..][..width + 2]
        });
        let slot = y as usize % 3;
        let (dx, dy) = (&mut self.dx[slot], &mut self.dy[slot]);
        sobel(simd, rows, &mut dx[1..=width], &mut dy[1..=width]);
        for row in [dx, dy] {
            row[0] = row[1 + reflect(-1, width)];
            row[width + 1] = row[1 + reflect(width as isize, width)];
        }
    }
}

multiversion! {
    /// 3x3 Sobel gradients; `rows` begin one column before the output.
    fn sobel(rows: [&[u8]; 3], dx: &mut [i16], dy: &mut [i16]) {
        let n = dx.len();
        let (up, middle, down) = (&rows[0][..n + 2], &rows[1][..n + 2], &rows[2][..n + 2]);
        let dy = &mut dy[..n];
        for x in 0..n {
            let (ul, uc, ur) = (i16::from(up[x]), i16::from(up[x + 1]), i16::from(up[x + 2]));
            let (l, r) = (i16::from(middle[x]), i16::from(middle[x + 2]));
            let (dl, dc, dr) = (i16::from(down[x]), i16::from(down[x + 1]), i16::from(down[x + 2]));
            dx[x] = (ur - ul) + 2 * (r - l) + (dr - dl);
            dy[x] = (dl - ul) + 2 * (dc - uc) + (dr - ur);
        }
    }
}

multiversion! {
    /// Products of gradients summed over three rows.
    fn sum_moments(
        dx: [&[i16]; 3],
        dy: [&[i16]; 3],
        xx: &mut [i32],
        xy: &mut [i32],
        yy: &mut [i32],
    ) {
        let n = xx.len();
        let (dx0, dx1, dx2) = (&dx[0][..n], &dx[1][..n], &dx[2][..n]);
        let (dy0, dy1, dy2) = (&dy[0][..n], &dy[1][..n], &dy[2][..n]);
        let (xy, yy) = (&mut xy[..n], &mut yy[..n]);
        for x in 0..n {
            let (a0, a1, a2) = (i32::from(dx0[x]), i32::from(dx1[x]), i32::from(dx2[x]));
            let (b0, b1, b2) = (i32::from(dy0[x]), i32::from(dy1[x]), i32::from(dy2[x]));
            xx[x] = a0 * a0 + a1 * a1 + a2 * a2;
            xy[x] = a0 * b0 + a1 * b1 + a2 * b2;
            yy[x] = b0 * b0 + b1 * b1 + b2 * b2;
        }
    }
}

multiversion! {
    /// Sums moments over three columns, writes the bits of the smaller
    /// eigenvalue and returns the greatest. The sums stay below 2^24: they are
    /// exact as floats.
    fn respond(xx: &[i32], xy: &[i32], yy: &[i32], out: &mut [u32]) -> Option<u32> {
        let n = out.len();
        let (xx, xy, yy) = (&xx[..n + 2], &xy[..n + 2], &yy[..n + 2]);
        let sum = |row: &[i32], x: usize| (row[x] + row[x + 1] + row[x + 2]) as f32;
        let mut best = 0;
        for (x, out) in out.iter_mut().enumerate() {
            let (a, b, c) = (sum(xx, x) * 0.5, sum(xy, x), sum(yy, x) * 0.5);
            let value = (a + c) - ((a - c) * (a - c) + b * b).sqrt();
            // A negative float, from rounding, has a negative sign bit.
            let bits = (value.to_bits() as i32).max(0);
            *out = bits as u32;
            best = best.max(bits);
        }
        Some(best as u32)
    }
}

multiversion! {
    /// Flags columns 1 to n - 2 whose response is above the threshold and not
    /// below any of its eight neighbours; returns whether there is any.
    fn flag_maxima(
        up: &[u32],
        middle: &[u32],
        down: &[u32],
        threshold: u32,
        flags: &mut [u8],
    ) -> u8 {
        let n = middle.len();
        let (up, down) = (&up[..n], &down[..n]);
        let flags = &mut flags[..n];
        let mut any = 0;
        // Bits of non-negative floats order the same as signed integers.
        let three = |row: &[u32], x: usize| {
            (row[x - 1] as i32).max(row[x] as i32).max(row[x + 1] as i32)
        };
        for x in 1..n - 1 {
            let value = middle[x] as i32;
            let around = three(up, x).max(three(down, x)).max(three(middle, x));
            let flag = u8::from(value >= around) & u8::from(value > threshold as i32);
            flags[x] = flag;
            any |= flag;
        }
        any
    }
}
