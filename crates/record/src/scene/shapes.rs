//! The parts of which a scene consists.

use foxglove::messages::{
    Color, CubePrimitive, Duration, LinePrimitive, Point3, Pose, Quaternion, SceneEntity, Vector3, line_primitive::Type,
};
use heliostat_channel::Vec3;

/// The frame of all positions.
pub const FRAME: &str = "room";

/// The twelve edges of an upright box.
pub struct CubeEdges {
    /// Its centre in m.
    pub centre: Vec3,
    /// Half its extents in m.
    pub half: Vec3,
}

impl CubeEdges {
    /// Two points for each edge: corners whose numbers differ in one bit.
    pub fn points(&self) -> Vec<Vec3> {
        let sign = |corner: usize, axis: usize| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
        let place = |corner| {
            self.centre + Vec3::new(sign(corner, 0), sign(corner, 1), sign(corner, 2)).component_mul(&self.half)
        };
        let edges = (0..8usize).flat_map(|from| (0..3).map(move |axis| (from, from | 1 << axis)));
        edges.filter(|(from, to)| from != to).flat_map(|(from, to)| [place(from), place(to)]).collect()
    }
}

/// A permanent entity that replaces an earlier one of the same name.
pub fn entity(id: &str) -> SceneEntity {
    SceneEntity {
        frame_id: FRAME.to_owned(),
        id: id.to_owned(),
        lifetime: Some(Duration::new(0, 0)),
        ..SceneEntity::default()
    }
}

/// A box with these extents along the axes.
pub fn cube(centre: &Vec3, size: Vec3, color: Color) -> CubePrimitive {
    CubePrimitive { pose: Some(pose(centre)), size: Some(vector(&size)), color: Some(color) }
}

/// Line segments between pairs of points.
pub fn segments(points: Vec<Vec3>, thickness: f64, color: Color) -> LinePrimitive {
    LinePrimitive {
        r#type: Type::LineList as i32,
        pose: Some(pose(&Vec3::zeros())),
        thickness,
        scale_invariant: false,
        points: points.iter().map(|point| Point3 { x: point.x, y: point.y, z: point.z }).collect(),
        color: Some(color),
        ..LinePrimitive::default()
    }
}

/// A position without a rotation.
pub fn pose(position: &Vec3) -> Pose {
    Pose { position: Some(vector(position)), orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }) }
}

/// A vector as Foxglove writes it.
pub fn vector(v: &Vec3) -> Vector3 {
    Vector3 { x: v.x, y: v.y, z: v.z }
}
