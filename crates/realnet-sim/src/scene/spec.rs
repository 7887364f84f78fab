//! What a world is asked to be.

/// Kinds of worlds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SceneKind {
    /// A furnished room.
    #[default]
    Room,
    /// A large hall with pillars and shelves.
    Hall,
    /// A track outdoors with kerbs, cones and buildings under the sky.
    Track,
    /// A corridor along the way.
    Corridor,
}

impl SceneKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Room, Self::Hall, Self::Track, Self::Corridor];

    /// Name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Room => "room",
            Self::Hall => "hall",
            Self::Track => "track",
            Self::Corridor => "corridor",
        }
    }
}

/// How much texture the surfaces have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TextureLevel {
    /// As real surfaces have.
    #[default]
    Rich,
    /// A tenth of the contrast on floor, walls and ceiling: little to track.
    Low,
}

/// From a time on, all light is multiplied by a factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightChange {
    /// When, seconds.
    pub time_s: f64,
    /// How bright from then on, as a multiple of [`SceneSpec::light`].
    pub factor: f64,
}

/// What a world is asked to be.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSpec {
    /// Room, hall, track or corridor.
    pub kind: SceneKind,
    /// Texture of the surfaces.
    pub texture: TextureLevel,
    /// Brightness, 1 is a well-lit room or a bright day, 0.03 is dusk.
    pub light: f64,
    /// Sudden changes of the brightness.
    pub light_changes: Vec<LightChange>,
    /// How many things stand about; fewer when there is no room for them.
    pub clutter: usize,
    /// How many things move about: balls, people, swinging boxes.
    pub moving: usize,
    /// The way that is driven, metres: nothing stands or moves near it, and the
    /// walls are put around it.
    pub keep_free: Vec<[f64; 2]>,
    /// How far from the way everything stays, metres.
    pub clearance_m: f64,
}

impl Default for SceneSpec {
    fn default() -> Self {
        Self {
            kind: SceneKind::Room,
            texture: TextureLevel::Rich,
            light: 1.0,
            light_changes: Vec::new(),
            clutter: 12,
            moving: 0,
            keep_free: vec![[0.0, 0.0], [3.0, 0.0]],
            clearance_m: 0.6,
        }
    }
}
