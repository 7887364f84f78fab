//! What the camera sees.

use super::Knock;
use super::draft::Draft;
use super::driving::{ahead, starting};
use crate::scene::{LightChange, TextureLevel};

pub(super) fn low_light(draft: &mut Draft) {
    ahead(draft, 0.5);
    draft.setup.scene.light = draft.between(0.08, 0.15);
    draft.setup.camera.noise = draft.between(1.5, 2.5);
    draft.setup.camera.exposure_s = 0.02;
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn exposure(draft: &mut Draft) {
    ahead(draft, 0.5);
    let (dim, back, glare) =
        (draft.between(0.25, 0.4), draft.between(5.0, 5.5), draft.between(1.5, 1.9));
    draft.setup.scene.light_changes = vec![
        LightChange { time_s: draft.between(3.0, 3.5), factor: dim },
        LightChange { time_s: back, factor: 1.0 },
        LightChange { time_s: draft.between(6.5, 7.0), factor: glare },
    ];
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.1);
    expect.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn blur(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.6));
    let route = draft.wander(6.0, 0.6, 2.5);
    draft.target(kind, route, starting(speed));
    draft.setup.camera.exposure_s = draft.between(0.022, 0.03);
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.1);
    expect.min_tracked_share = Some(0.9);
}

pub(super) fn low_texture(draft: &mut Draft) {
    ahead(draft, 0.5);
    draft.setup.scene.texture = TextureLevel::Low;
    draft.setup.scene.clutter = 3;
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn moving_clutter(draft: &mut Draft) {
    ahead(draft, 0.5);
    draft.setup.scene.moving = 5;
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.1);
    expect.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn knocked_camera(draft: &mut Draft) {
    ahead(draft, 0.5);
    let angle = draft.side() * 5.0_f64.to_radians();
    let mut knock = Knock { time_s: draft.between(4.0, 4.5), ..Knock::default() };
    match draft.between(0.0, 3.0) as u32 {
        0 => knock.roll = angle,
        1 => knock.pitch = angle,
        _ => knock.yaw = angle,
    }
    draft.setup.camera.knocks.push(knock);
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.25);
    expect.max_lateral_rmse_m = Some(0.25);
}
