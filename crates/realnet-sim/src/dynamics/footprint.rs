//! How near convex footprints come to each other.

use crate::VehicleSize;
use realnet_core::Pose2;
use realnet_core::nalgebra::Vector2;

/// Least distance between two convex polygons, metres; 0 when they touch or overlap.
/// Corners in order, either way round, at least three each; infinite for fewer.
///
/// Polygons that do not overlap are nearest at a corner of one of them; whether they
/// do overlap is told by the separating axes of their sides.
#[must_use]
pub fn clearance(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    if a.len() < 3 || b.len() < 3 {
        return f64::INFINITY;
    }
    if !separated(a, b) && !separated(b, a) {
        return 0.0;
    }
    nearest_corner(a, b).min(nearest_corner(b, a))
}

/// Free way from the middle of a vehicle's front bumper to a target's footprint,
/// along the line from there to the footprint's middle, metres; 0 when the bumper is
/// inside of it, infinite for a footprint of less than three corners.
#[must_use]
pub fn gap_ahead(world_from_base: &Pose2, size: &VehicleSize, target: &[Vector2<f64>]) -> f64 {
    let bumper = world_from_base.transform_point(&Vector2::new(size.front(), 0.0));
    if target.len() < 3 {
        return f64::INFINITY;
    }
    if !separated(target, &[bumper]) {
        return 0.0;
    }
    let middle = target.iter().sum::<Vector2<f64>>() / target.len() as f64;
    let line = middle - bumper;
    // Where the line enters: the last of the sides that it crosses from outside.
    let crossings = sides(target).filter_map(|(from, to)| {
        let side = to - from;
        let slope = line.perp(&side);
        let start = from - bumper;
        let (along, across) = (start.perp(&side) / slope, start.perp(&line) / slope);
        ((0.0..=1.0).contains(&across) && along >= 0.0).then_some(along)
    });
    crossings.fold(1.0, f64::min) * line.norm()
}

fn sides(polygon: &[Vector2<f64>]) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + '_ {
    polygon.iter().copied().zip(polygon.iter().copied().cycle().skip(1))
}

/// Whether a line along a side of `a` has the two on different sides.
fn separated(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> bool {
    sides(a).any(|(from, to)| {
        let side = to - from;
        let normal = Vector2::new(side.y, -side.x);
        let span = |polygon: &[Vector2<f64>]| {
            polygon
                .iter()
                .map(|corner| normal.dot(&(corner - from)))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
                    (least.min(value), most.max(value))
                })
        };
        let ((a_least, a_most), (b_least, b_most)) = (span(a), span(b));
        a_most < b_least || b_most < a_least
    })
}

/// Least distance of a corner of `a` from a side of `b`.
fn nearest_corner(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    let distance = |corner: &Vector2<f64>, from: Vector2<f64>, to: Vector2<f64>| {
        let side = to - from;
        let length = side.norm_squared();
        let along = if length > 0.0 { (corner - from).dot(&side) / length } else { 0.0 };
        (corner - from - side * along.clamp(0.0, 1.0)).norm()
    };
    a.iter()
        .flat_map(|corner| sides(b).map(move |(from, to)| distance(corner, from, to)))
        .fold(f64::INFINITY, f64::min)
}
