//! Which tiles each surface touches.

use super::canvas::{Rays, Span2};
use super::surface::Surface;

/// A surface on a tile, and which of its edges cross the tile.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) tile: u32,
    pub(super) index: u16,
    pub(super) edges: u16,
}

/// Lists of surfaces, or of shadows, for each tile; in the order they were added.
#[derive(Clone, Debug, Default)]
pub(super) struct Bins {
    added: Vec<Entry>,
    sorted: Vec<Entry>,
    starts: Vec<u32>,
}

impl Bins {
    pub(super) fn clear(&mut self) {
        self.added.clear();
    }

    /// Adds a surface wherever it may be seen.
    pub(super) fn add_surface(
        &mut self,
        rays: &Rays,
        index: u16,
        surface: &Surface,
        bounds: &Span2,
    ) {
        let edges = &surface.edges[..surface.edge_count];
        self.add(rays, index, bounds, |tile| {
            // Behind the camera, or looking away, on all of the tile.
            if tile.range(surface.inverse)[1] <= 0.0 {
                return None;
            }
            let mut crossing = 0;
            for (bit, &edge) in edges.iter().enumerate() {
                let [least, greatest] = tile.range(edge);
                // Rounding here may differ from that at the pixels.
                let doubt = 1e-5 * (edge[0].abs() + edge[1].abs() + edge[2].abs());
                if greatest < -doubt {
                    return None;
                }
                if least < doubt {
                    crossing |= 1 << bit;
                }
            }
            Some(crossing)
        });
    }

    /// Adds what lies within `bounds`, where `test` answers.
    pub(super) fn add(
        &mut self,
        rays: &Rays,
        index: u16,
        bounds: &Span2,
        test: impl Fn(&Span2) -> Option<u16>,
    ) {
        let across = |list: &[Span2], hit: &dyn Fn(&Span2) -> bool| {
            let first = list.iter().position(hit);
            let last = list.iter().rposition(hit);
            first.zip(last).map_or(0..0, |(first, last)| first..last + 1)
        };
        let columns = across(&rays.columns, &|c| c.x[0] <= bounds.x[1] && c.x[1] >= bounds.x[0]);
        let rows = across(&rays.rows, &|r| r.y[0] <= bounds.y[1] && r.y[1] >= bounds.y[0]);
        for row in rows {
            for column in columns.clone() {
                let tile = row * rays.tiles_x + column;
                let span = &rays.tiles[tile];
                if let Some(edges) = span.meets(bounds).then(|| test(span)).flatten() {
                    self.added.push(Entry { tile: tile as u32, index, edges });
                }
            }
        }
    }

    /// Sorts by tile. To be called before [`Bins::of`].
    pub(super) fn sort(&mut self, tiles: usize) {
        self.starts.clear();
        self.starts.resize(tiles + 1, 0);
        for entry in &self.added {
            self.starts[entry.tile as usize + 1] += 1;
        }
        for i in 0..tiles {
            self.starts[i + 1] += self.starts[i];
        }
        self.sorted.clear();
        self.sorted.resize(self.added.len(), Entry { tile: 0, index: 0, edges: 0 });
        for entry in &self.added {
            let place = &mut self.starts[entry.tile as usize];
            self.sorted[*place as usize] = *entry;
            *place += 1;
        }
        // Each start has moved to its end, which is the start of the next.
    }

    /// The list of a tile.
    pub(super) fn of(&self, tile: usize) -> &[Entry] {
        let start = if tile == 0 { 0 } else { self.starts[tile - 1] };
        &self.sorted[start as usize..self.starts[tile] as usize]
    }
}
