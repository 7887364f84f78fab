//! Buffers of a picture in the making, and the rays of its pixels. All are padded to
//! whole tiles.

use realnet_core::CameraModel;

/// Pixels of a tile along x: the widest vector of floats.
pub(super) const TILE_W: usize = 16;
/// Pixels of a tile along y.
pub(super) const TILE_H: usize = 8;
/// Pixels of a tile.
pub(super) const TILE: usize = TILE_W * TILE_H;

/// A value for each pixel of a row of a tile.
pub(super) type Lane<T = f32> = [T; TILE_W];

/// Least and greatest value along x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span2 {
    pub(super) x: [f32; 2],
    pub(super) y: [f32; 2],
}

impl Span2 {
    pub(super) const EMPTY: Self =
        Self { x: [f32::INFINITY, f32::NEG_INFINITY], y: [f32::INFINITY, f32::NEG_INFINITY] };

    pub(super) fn add(&mut self, x: f32, y: f32) {
        // `min` and `max` pass over what is not a number.
        self.x = [self.x[0].min(x), self.x[1].max(x)];
        self.y = [self.y[0].min(y), self.y[1].max(y)];
    }

    fn join(&mut self, other: &Self) {
        self.add(other.x[0], other.y[0]);
        self.add(other.x[1], other.y[1]);
    }

    pub(super) fn meets(&self, other: &Self) -> bool {
        self.x[0] <= other.x[1]
            && self.x[1] >= other.x[0]
            && self.y[0] <= other.y[1]
            && self.y[1] >= other.y[0]
    }

    /// Least and greatest value of `a x + b y + c` over it.
    pub(super) fn range(&self, [a, b, c]: [f32; 3]) -> [f32; 2] {
        let (ax, by) = (self.x.map(|x| a * x), self.y.map(|y| b * y));
        [ax[0].min(ax[1]) + by[0].min(by[1]) + c, ax[0].max(ax[1]) + by[0].max(by[1]) + c]
    }
}

/// The rays of a camera's pixels, row by row.
#[derive(Clone, Debug)]
pub(super) struct Rays {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Pixels from row to row.
    pub(super) stride: usize,
    pub(super) tiles_x: usize,
    /// `x / z`, or not a number where the lens sees nothing.
    pub(super) x: Vec<f32>,
    /// `y / z`.
    pub(super) y: Vec<f32>,
    /// For each row of each tile: the ray's change to the next pixel on the right,
    /// then to the next one below.
    pub(super) steps: Vec<[f32; 4]>,
    /// For each tile, row by row.
    pub(super) tiles: Vec<Span2>,
    pub(super) columns: Vec<Span2>,
    pub(super) rows: Vec<Span2>,
}

impl Rays {
    pub(super) fn new(model: &CameraModel) -> Self {
        let (width, height) = (model.width() as usize, model.height() as usize);
        let (tiles_x, tiles_y) = (width.div_ceil(TILE_W), height.div_ceil(TILE_H));
        let stride = tiles_x * TILE_W;
        let ray = |x: usize, y: usize| {
            let pixel = [x.min(width - 1) as f64, y.min(height - 1) as f64];
            model.unproject(pixel).unwrap_or([f64::NAN; 2])
        };
        let pixels = stride * tiles_y * TILE_H;
        let (mut xs, mut ys) = (Vec::with_capacity(pixels), Vec::with_capacity(pixels));
        let mut tiles = vec![Span2::EMPTY; tiles_x * tiles_y];
        for y in 0..tiles_y * TILE_H {
            for x in 0..stride {
                let [rx, ry] = ray(x, y).map(|v| v as f32);
                xs.push(rx);
                ys.push(ry);
                tiles[(y / TILE_H) * tiles_x + x / TILE_W].add(rx, ry);
            }
        }
        let mut columns = vec![Span2::EMPTY; tiles_x];
        let mut rows = vec![Span2::EMPTY; tiles_y];
        for (index, tile) in tiles.iter().enumerate() {
            columns[index % tiles_x].join(tile);
            rows[index / tiles_x].join(tile);
        }
        let flat = [1.0 / model.fx(), 1.0 / model.fy()];
        let step = |a: usize, b: usize, apart: f64, vertical: bool| {
            let x = (f64::from(xs[b]) - f64::from(xs[a])) / apart;
            let y = (f64::from(ys[b]) - f64::from(ys[a])) / apart;
            if x.is_finite() && y.is_finite() {
                [x as f32, y as f32]
            } else if vertical {
                [0.0, flat[1] as f32]
            } else {
                [flat[0] as f32, 0.0]
            }
        };
        let mut steps = Vec::with_capacity(tiles_x * tiles_y * TILE_H);
        for y in 0..tiles_y * TILE_H {
            for tile in 0..tiles_x {
                let x = (tile * TILE_W).min(width.saturating_sub(2));
                let last = (x + TILE_W - 1).min(width - 1).max(x);
                let row = y.min(height - 1);
                let [ux, uy] =
                    step(row * stride + x, row * stride + last, (last - x).max(1) as f64, false);
                let middle = (x + last) / 2;
                let above = row.saturating_sub(1);
                let below = (row + 1).min(height - 1);
                let apart = (below - above).max(1) as f64;
                let [vx, vy] = step(above * stride + middle, below * stride + middle, apart, true);
                steps.push([ux, uy, vx, vy]);
            }
        }
        Self { width, height, stride, tiles_x, x: xs, y: ys, steps, tiles, columns, rows }
    }

    /// Pixels, padding included.
    pub(super) fn len(&self) -> usize {
        self.x.len()
    }

    /// Index of the first pixel of a tile.
    pub(super) fn tile_start(&self, tile: usize) -> usize {
        (tile / self.tiles_x) * TILE_H * self.stride + (tile % self.tiles_x) * TILE_W
    }
}

/// What is seen at each pixel, in buffers as the rays'.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    /// Inverse depth, 0 where nothing is.
    pub(super) inverse: Vec<f32>,
    /// Index of the surface, and above bit 16 the instance.
    pub(super) id: Vec<u32>,
    /// Linear light: red, green, blue.
    pub(super) light: [Vec<f32>; 3],
}

impl Canvas {
    pub(super) fn new(pixels: usize) -> Self {
        let empty = || vec![0.0; pixels];
        Self { inverse: empty(), id: vec![0; pixels], light: [empty(), empty(), empty()] }
    }
}
