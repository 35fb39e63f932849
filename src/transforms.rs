//! Transforms of `/tf` and `/tf_static`, and the mount of the laser on the robot.

use std::cmp::Ordering;
use std::collections::HashMap;
use std::f64::consts::PI;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;
use thiserror::Error;

use crate::geometry::Pose2;
use crate::knobs::{KnobValue, expected, numbers, radians};
use crate::messages::geometry_msgs;
use crate::messages::tf2_msgs::TFMessage;
use crate::time::Stamp;

/// Maximum plausible coordinate, m: larger than any distance on Earth, and than UTM coordinates.
pub const MAX_COORDINATE: f64 = 1e8;
/// Maximum length of a chain of frames. A longer one is a loop.
const MAX_CHAIN: usize = 100;

/// The mount of a laser on the robot, reduced to what matters in the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Position and heading of the laser's x axis in the base frame.
    pub base_from_laser: Pose2,
    /// Whether the laser is mounted upside down: its sweep, seen from above, has the opposite direction.
    pub upside_down: bool,
    /// Angle between the scan plane and the plane of the base, rad, from 0 to pi / 2.
    pub tilt: f64,
    /// Transform from the laser's frame to a level frame at the laser's position, with its heading, in the plane of the base: z
    /// is then the height above the base.
    pub level_from_laser: Isometry3<f64>,
}

impl Mount {
    /// The mount of a laser at this pose on the base.
    fn new(base_from_laser: &Isometry3<f64>) -> Self {
        let forward = base_from_laser.rotation * Vector3::x();
        let up = base_from_laser.rotation * Vector3::z();
        let position = base_from_laser.translation.vector;
        let heading = forward.y.atan2(forward.x);
        let base_from_level = Isometry3::from_parts(
            Translation3::new(position.x, position.y, 0.0),
            UnitQuaternion::from_euler_angles(0.0, 0.0, heading),
        );
        Self {
            base_from_laser: Pose2::new(position.x, position.y, heading),
            upside_down: up.z < 0.0,
            tilt: up.z.abs().min(1.0).acos(),
            level_from_laser: base_from_level.inverse() * base_from_laser,
        }
    }

    /// Rejects a laser whose scan plane is tilted against the floor.
    pub fn check_level(&self, base: &str, laser: &str) -> Result<(), TiltedMount> {
        if self.tilt > MAX_TILT {
            return Err(TiltedMount { laser: frame_name(laser).into(), base: frame_name(base).into(), tilt: self.tilt });
        }
        Ok(())
    }
}

/// The pose of a laser on the robot, as a parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LaserPose {
    /// Position and heading of the laser's x axis in the base frame.
    pub base_from_laser: Pose2,
    /// Roll about that axis, rad: pi is upside down. `None`: taken from the transforms.
    pub roll: Option<f64>,
}

impl LaserPose {
    /// The mount of the laser at this height, m; upright unless the roll is given.
    pub fn mount(&self, height: f64) -> Mount {
        let Pose2 { x, y, theta } = self.base_from_laser;
        let rotation = UnitQuaternion::from_euler_angles(self.roll.unwrap_or(0.0), 0.0, theta);
        Mount::new(&Isometry3::from_parts(Translation3::new(x, y, height), rotation))
    }
}

impl From<Pose2> for LaserPose {
    fn from(base_from_laser: Pose2) -> Self {
        Self { base_from_laser, roll: None }
    }
}

impl KnobValue for LaserPose {
    fn from_value(value: &Value) -> Result<Self, String> {
        match numbers(value).as_deref() {
            Some(&[x, y, yaw]) => Ok(Pose2::new(x, y, radians(yaw)?).into()),
            Some(&[x, y, yaw, roll]) => Ok(Self { roll: Some(radians(roll)?), ..Pose2::new(x, y, radians(yaw)?).into() }),
            _ => Err(expected(Self::kind(), value)),
        }
    }

    fn to_value(&self) -> Value {
        let Pose2 { x, y, theta } = self.base_from_laser;
        [x, y, theta].into_iter().chain(self.roll).collect()
    }

    fn kind() -> String {
        "[x, y, yaw] or [x, y, yaw, roll]".into()
    }
}

/// The scan plane of a laser is tilted against the floor.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "the sweep of '{laser}' is tilted by {:.0} degrees against '{base}': planar matching allows at most {:.0} (correct the \
     transform from '{base}' to '{laser}' or the roll in odometry.laser_in_base, or level the laser)",
    .tilt.to_degrees(), MAX_TILT.to_degrees()
)]
pub struct TiltedMount {
    /// The laser's frame.
    pub laser: String,
    /// The base's frame.
    pub base: String,
    /// The angle, rad.
    pub tilt: f64,
}

/// Maximum tilt of the scan plane, rad. At this tilt, a wall at 10 m seems 6 % farther, and a laser 1 m above the floor sees it
/// at 3 m.
const MAX_TILT: f64 = 20.0 * PI / 180.0;

/// Maximum time between two transforms for interpolation, s.
const MAX_INTERPOLATION_TIME: f64 = 0.5;
/// Maximum speed of a moving mount, m/s. A faster one was remounted.
const MAX_MOUNT_SPEED: f64 = 2.0;
/// Maximum rotation rate of a moving mount, rad/s.
const MAX_MOUNT_ROTATION_RATE: f64 = 8.0;

/// The tree of frames: the last known transform of every frame to its parent.
#[derive(Debug, Default)]
pub struct TransformTree {
    parents: HashMap<String, Link>,
}

/// The pose of a frame in its parent.
#[derive(Debug)]
struct Link {
    parent: String,
    last: Isometry3<f64>,
    stamp: Stamp,
    /// The previous transform, if the frame moves.
    before: Option<(Stamp, Isometry3<f64>)>,
}

impl Link {
    /// The pose at a time, interpolated from the last two: a panning laser is published at another rate than its scans.
    fn at(&self, stamp: Stamp) -> Isometry3<f64> {
        self.interpolated(stamp).unwrap_or(self.last)
    }

    fn interpolated(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        let (start, before) = self.before?;
        let seconds = self.stamp.seconds_since(start);
        let motion = before.inverse() * self.last;
        let is_motion = seconds > 0.0
            && seconds <= MAX_INTERPOLATION_TIME
            && motion.translation.vector.norm() <= MAX_MOUNT_SPEED * seconds
            && motion.rotation.angle() <= MAX_MOUNT_ROTATION_RATE * seconds;
        // Extrapolate by at most the interval between the two.
        let fraction = (stamp.seconds_since(start) / seconds).clamp(0.0, 2.0);
        is_motion.then(|| {
            let position = before.translation.vector.lerp(&self.last.translation.vector, fraction);
            Isometry3::from_parts(position.into(), before.rotation * motion.rotation.powf(fraction))
        })
    }
}

impl TransformTree {
    /// Adds the transforms of a message. Returns how many were rejected because they are not rigid motions.
    pub fn add(&mut self, message: &TFMessage) -> usize {
        let mut rejected = 0;
        for stamped in &message.transforms {
            let (parent, child) = (frame_name(&stamped.header.frame_id), frame_name(&stamped.child_frame_id));
            let geometry_msgs::Transform { translation: t, rotation } = &stamped.transform;
            match rigid_motion([t.x, t.y, t.z], rotation) {
                Some(transform) if parent != child => self.insert(parent, child, stamped.header.stamp.into(), transform),
                _ => rejected += 1,
            }
        }
        rejected
    }

    fn insert(&mut self, parent: &str, child: &str, stamp: Stamp, last: Isometry3<f64>) {
        let known = self.parents.get(child).filter(|link| link.parent == parent);
        let before = known.and_then(|link| match stamp.cmp(&link.stamp) {
            Ordering::Greater => Some((link.stamp, link.last)),
            Ordering::Equal => link.before,
            Ordering::Less => None,
        });
        self.parents.insert(child.to_owned(), Link { parent: parent.to_owned(), last, stamp, before });
    }

    /// The parent of a frame.
    pub fn parent(&self, frame: &str) -> Option<&str> {
        self.parents.get(frame_name(frame)).map(|link| link.parent.as_str())
    }

    /// Whether `ancestor` is `frame` itself or one of its ancestors, so that `frame` moves with it.
    pub fn is_ancestor(&self, ancestor: &str, frame: &str) -> bool {
        self.ancestors(frame, |link| link.last).any(|(name, _)| name == frame_name(ancestor))
    }

    /// The mount of `laser` on `base` from the last transforms; `None` if the frames are not connected.
    pub fn mount(&self, base: &str, laser: &str) -> Option<Mount> {
        self.mount_by(base, laser, |link| link.last)
    }

    fn mount_by(&self, base: &str, laser: &str, transform: impl Fn(&Link) -> Isometry3<f64>) -> Option<Mount> {
        let (base_root, root_from_base) = self.root(base, &transform)?;
        let (laser_root, root_from_laser) = self.root(laser, &transform)?;
        if base_root != laser_root {
            return None;
        }
        Some(Mount::new(&(root_from_base.inverse() * root_from_laser)))
    }

    /// The mount of a laser at a time: from the parameter if it is set, else from the transforms. The transforms always give the
    /// height, and the roll if the parameter does not.
    pub fn laser_mount(&self, base: &str, laser: &str, stamp: Stamp, parameter: Option<LaserPose>) -> Option<Mount> {
        let by_transforms = self.mount_by(base, laser, |link| link.at(stamp));
        let Some(pose) = parameter else { return by_transforms };
        Some(match by_transforms {
            Some(mount) if pose.roll.is_none() => Mount { base_from_laser: pose.base_from_laser, ..mount },
            Some(mount) => pose.mount(mount.level_from_laser.translation.z),
            None => pose.mount(0.0),
        })
    }

    /// Rejects a laser whose scan plane is tilted against the first of its ancestors among `bases`, or against the root of its
    /// frames if there is none.
    pub fn check_level(&self, bases: &[&str], laser: &str) -> Result<(), TiltedMount> {
        let ancestors: Vec<_> = self.ancestors(laser, |link| link.last).collect();
        let is_base = |(frame, _): &&(&str, Isometry3<f64>)| bases.iter().any(|base| frame_name(base) == *frame);
        let base = ancestors.iter().find(is_base).or(ancestors.last());
        base.map_or(Ok(()), |(frame, frame_from_laser)| Mount::new(frame_from_laser).check_level(frame, laser))
    }

    /// The transform from `inner` to `outer`, if they are connected without passing through any of the `moving` frames.
    pub fn fixed_transform(&self, outer: &str, inner: &str, moving: &[&str]) -> Option<Isometry3<f64>> {
        let [of_outer, of_inner] = [outer, inner].map(|frame| self.ancestors(frame, |link| link.last).collect::<Vec<_>>());
        let is_common = |(frame, _): &&(&str, Isometry3<f64>)| of_inner.iter().any(|(other, _)| other == frame);
        let &(common, common_from_outer) = of_outer.iter().find(is_common)?;
        let &(_, common_from_inner) = of_inner.iter().find(|(frame, _)| *frame == common)?;
        let passes_moving = |chain: &[(&str, Isometry3<f64>)]| {
            let below = chain.iter().take_while(|(frame, _)| *frame != common);
            below.map(|(frame, _)| *frame).chain([common]).any(|frame| moving.contains(&frame))
        };
        let is_moving = passes_moving(&of_outer) || passes_moving(&of_inner);
        (!is_moving).then(|| common_from_outer.inverse() * common_from_inner)
    }

    /// A frame and its ancestors, each with the pose of the frame in it; `transform` gives the pose of a frame in its parent.
    fn ancestors<'a>(
        &'a self,
        frame: &'a str,
        transform: impl Fn(&Link) -> Isometry3<f64>,
    ) -> impl Iterator<Item = (&'a str, Isometry3<f64>)> {
        let first = (frame_name(frame), Isometry3::identity());
        let up = move |(frame, ancestor_from_frame): &(&'a str, Isometry3<f64>)| {
            self.parents.get(*frame).map(|link| (link.parent.as_str(), transform(link) * ancestor_from_frame))
        };
        std::iter::successors(Some(first), up).take(MAX_CHAIN)
    }

    /// The root of a frame, and the pose of the frame in it; `None` if the frames form a loop.
    fn root<'a>(&'a self, frame: &'a str, transform: impl Fn(&Link) -> Isometry3<f64>) -> Option<(&'a str, Isometry3<f64>)> {
        self.ancestors(frame, transform).last().filter(|(root, _)| self.parent(root).is_none())
    }
}

/// The name of a frame without a leading slash: tf2 has none, older nodes write one.
pub fn frame_name(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// The rigid motion of a message; `None` if it is invalid.
pub fn rigid_motion(position: [f64; 3], rotation: &geometry_msgs::Quaternion) -> Option<Isometry3<f64>> {
    let [x, y, z] = position;
    let rotation = UnitQuaternion::try_new(Quaternion::new(rotation.w, rotation.x, rotation.y, rotation.z), 1e-3)?;
    let isometry = Isometry3::from_parts(Translation3::new(x, y, z), rotation);
    let is_rigid = rotation.coords.iter().all(|v| v.is_finite()) && position.iter().all(|v| v.abs() <= MAX_COORDINATE);
    is_rigid.then_some(isometry)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::std_msgs::Header;

    /// A tree of transforms: parent, child, and the x coordinate of the child in the parent, m.
    fn tree(transforms: &[(&str, &str, f64)]) -> TransformTree {
        let stamped = |&(parent, child, x): &(&str, &str, f64)| geometry_msgs::TransformStamped {
            header: Header { frame_id: parent.into(), ..Header::default() },
            child_frame_id: child.into(),
            transform: Pose2::new(x, 0.0, 0.0).into(),
        };
        let mut tree = TransformTree::default();
        assert_eq!(tree.add(&TFMessage { transforms: transforms.iter().map(stamped).collect() }), 0);
        tree
    }

    #[test]
    fn a_moving_mount_is_interpolated_to_the_time_of_the_scan() {
        let mut tree = TransformTree::default();
        for (seconds, yaw) in [(0.9, 0.1), (1.0, 0.1), (0.9, 0.1), (1.0, 0.1), (1.1, 0.3), (1.1, 0.3)] {
            let stamp = Stamp::from_seconds(seconds).into();
            let stamped = geometry_msgs::TransformStamped {
                header: Header { frame_id: "base_link".into(), stamp, ..Header::default() },
                child_frame_id: "laser".into(),
                transform: Pose2::new(0.2, 0.0, yaw).into(),
            };
            tree.add(&TFMessage { transforms: vec![stamped] });
        }
        let yaw = |seconds: f64| {
            let mount = tree.laser_mount("base_link", "laser", Stamp::from_seconds(seconds), None).unwrap();
            mount.base_from_laser.theta
        };
        for (seconds, expected) in [(1.05, 0.2), (1.1, 0.3), (1.15, 0.4), (1.5, 0.5), (0.9, 0.1)] {
            assert!((yaw(seconds) - expected).abs() < 1e-9, "{seconds} s: {}", yaw(seconds));
        }
        assert!((tree.mount("base_link", "laser").unwrap().base_from_laser.theta - 0.3).abs() < 1e-9);
    }

    #[test]
    fn frames_are_fixed_to_each_other_unless_a_moving_frame_connects_them() {
        let tree = tree(&[
            ("map", "odom", 5.0),
            ("odom", "base_footprint", 7.0),
            ("base_footprint", "base_link", 0.1),
            ("base_link", "camera", 0.3),
            ("camera_odom", "camera_pose", 2.0),
            ("map", "camera_odom", 1.0),
        ]);
        let distance = |outer, inner| tree.fixed_transform(outer, inner, &["odom", "map"]).map(|pose| pose.translation.x);
        assert!((distance("base_footprint", "/base_link").unwrap() - 0.1).abs() < 1e-12);
        assert!((distance("camera", "base_link").unwrap() + 0.3).abs() < 1e-12);
        assert!((distance("camera", "base_footprint").unwrap() + 0.4).abs() < 1e-12);
        assert_eq!(distance("camera_pose", "base_link"), None, "connected only through the map");
        assert_eq!(distance("nowhere", "base_link"), None);
    }
}
