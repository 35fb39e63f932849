//! What `/tf` and `/tf_static` say of where the laser is mounted.

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

/// No coordinate on Earth is greater, m: nor are those of UTM.
pub const FARTHEST: f64 = 1e8;
/// A chain longer than this is a loop.
const MAX_CHAIN: usize = 100;

/// The place of a laser on the robot, as far as it matters in the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Place and heading of the laser's x axis in the base frame.
    pub base_from_laser: Pose2,
    /// Whether the laser is on its head: its sweep, seen from above, runs the other way round.
    pub upside_down: bool,
    /// Angle between the plane of its sweep and that of the base, rad, from 0 to pi / 2.
    pub tilt: f64,
    /// From the laser's frame to a level one at the same place and heading of the base's plane: z is then the height above the base.
    pub level_from_laser: Isometry3<f64>,
}

impl Mount {
    /// Of a laser at this place on the base.
    fn of(base_from_laser: &Isometry3<f64>) -> Self {
        let forward = base_from_laser.rotation * Vector3::x();
        let up = base_from_laser.rotation * Vector3::z();
        let place = base_from_laser.translation.vector;
        let heading = forward.y.atan2(forward.x);
        let base_from_level =
            Isometry3::from_parts(Translation3::new(place.x, place.y, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, heading));
        Self {
            base_from_laser: Pose2::new(place.x, place.y, heading),
            upside_down: up.z < 0.0,
            tilt: up.z.abs().min(1.0).acos(),
            level_from_laser: base_from_level.inverse() * base_from_laser,
        }
    }

    /// Refuses a laser whose sweep does not go along the floor.
    pub fn check_level(&self, base: &str, laser: &str) -> Result<(), TiltedMount> {
        if self.tilt > MOST_TILT {
            return Err(TiltedMount { laser: frame_name(laser).into(), base: frame_name(base).into(), tilt: self.tilt });
        }
        Ok(())
    }
}

/// The place of a laser on the robot, as a parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LaserPlace {
    /// Place and heading of the laser's x axis in the base frame.
    pub base_from_laser: Pose2,
    /// Its turn about that axis, rad: pi is on its head. `None`: as the transforms say.
    pub roll: Option<f64>,
}

impl LaserPlace {
    /// Of a laser at this height, m, the right way up where nothing else is said.
    pub fn mount(&self, height: f64) -> Mount {
        let Pose2 { x, y, theta } = self.base_from_laser;
        let rotation = UnitQuaternion::from_euler_angles(self.roll.unwrap_or(0.0), 0.0, theta);
        Mount::of(&Isometry3::from_parts(Translation3::new(x, y, height), rotation))
    }
}

impl From<Pose2> for LaserPlace {
    fn from(base_from_laser: Pose2) -> Self {
        Self { base_from_laser, roll: None }
    }
}

impl KnobValue for LaserPlace {
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

/// A laser that does not look along the floor.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "the sweep of '{laser}' is tilted by {:.0} degrees against '{base}': scans match in the plane only up to {:.0} (mend the \
     transform from '{base}' to '{laser}' or the roll in odometry.laser_in_base, or level the laser)",
    .tilt.to_degrees(), MOST_TILT.to_degrees()
)]
pub struct TiltedMount {
    /// The laser's frame.
    pub laser: String,
    /// The base's frame.
    pub base: String,
    /// The angle, rad.
    pub tilt: f64,
}

/// At this tilt, rad, a wall 10 m away seems 6 % farther, and the floor is seen from 1 m above it at 3 m.
const MOST_TILT: f64 = 20.0 * PI / 180.0;

/// A motion that is older than this says nothing of where a frame is, s.
const LONGEST_MOTION: f64 = 0.5;
/// A mount that seems to move faster was put elsewhere, m/s ...
const FASTEST_MOUNT: f64 = 2.0;
/// ... and rad/s.
const FASTEST_TURN: f64 = 8.0;

/// The last known transform of every frame to its parent.
#[derive(Debug, Default)]
pub struct TransformTree {
    parents: HashMap<String, Link>,
}

/// A frame's place in its parent.
#[derive(Debug)]
struct Link {
    parent: String,
    last: Isometry3<f64>,
    stamp: Stamp,
    /// The one before, of a frame that moves.
    before: Option<(Stamp, Isometry3<f64>)>,
}

impl Link {
    /// The place at a time, as the last two have it: a laser that pans is published at another rate than its scans are.
    fn at(&self, stamp: Stamp) -> Isometry3<f64> {
        self.moved_to(stamp).unwrap_or(self.last)
    }

    fn moved_to(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        let (start, before) = self.before?;
        let seconds = self.stamp.seconds_since(start);
        let motion = before.inverse() * self.last;
        let is_motion = seconds > 0.0
            && seconds <= LONGEST_MOTION
            && motion.translation.vector.norm() <= FASTEST_MOUNT * seconds
            && motion.rotation.angle() <= FASTEST_TURN * seconds;
        // As long again as they are apart it goes on as it did.
        let part = (stamp.seconds_since(start) / seconds).clamp(0.0, 2.0);
        is_motion.then(|| {
            let place = before.translation.vector.lerp(&self.last.translation.vector, part);
            Isometry3::from_parts(place.into(), before.rotation * motion.rotation.powf(part))
        })
    }
}

impl TransformTree {
    /// Takes a message; answers how many of its transforms are no rigid motion and were left out.
    pub fn add(&mut self, message: &TFMessage) -> usize {
        let mut refused = 0;
        for stamped in &message.transforms {
            let (parent, child) = (frame_name(&stamped.header.frame_id), frame_name(&stamped.child_frame_id));
            let geometry_msgs::Transform { translation: t, rotation } = &stamped.transform;
            match rigid_motion([t.x, t.y, t.z], rotation) {
                Some(transform) if parent != child => self.insert(parent, child, stamped.header.stamp.into(), transform),
                _ => refused += 1,
            }
        }
        refused
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

    /// The frame that `frame` hangs from.
    pub fn parent(&self, frame: &str) -> Option<&str> {
        self.parents.get(frame_name(frame)).map(|link| link.parent.as_str())
    }

    /// Whether `frame` moves with `carrier`: it is that frame, or hangs from it, directly or through others.
    pub fn carries(&self, carrier: &str, frame: &str) -> bool {
        let (carrier, mut frame) = (frame_name(carrier), frame_name(frame));
        for _ in 0..MAX_CHAIN {
            if frame == carrier {
                return true;
            }
            let Some(parent) = self.parent(frame) else { return false };
            frame = parent;
        }
        false
    }

    /// The place of `laser` on `base` by the last transforms, when the frames are connected.
    pub fn mount(&self, base: &str, laser: &str) -> Option<Mount> {
        self.mount_by(base, laser, |link| link.last)
    }

    fn mount_by(&self, base: &str, laser: &str, place: impl Fn(&Link) -> Isometry3<f64>) -> Option<Mount> {
        let (base_root, root_from_base) = self.root(base, &place)?;
        let (laser_root, root_from_laser) = self.root(laser, &place)?;
        if base_root != laser_root {
            return None;
        }
        Some(Mount::of(&(root_from_base.inverse() * root_from_laser)))
    }

    /// The place of a laser at a time: where the parameter says, else the transforms. They say how high it is, and which side is up where
    /// the parameter does not.
    pub fn laser_mount(&self, base: &str, laser: &str, stamp: Stamp, parameter: Option<LaserPlace>) -> Option<Mount> {
        let by_transforms = self.mount_by(base, laser, |link| link.at(stamp));
        let Some(place) = parameter else { return by_transforms };
        Some(match by_transforms {
            Some(mount) if place.roll.is_none() => Mount { base_from_laser: place.base_from_laser, ..mount },
            Some(mount) => place.mount(mount.level_from_laser.translation.z),
            None => place.mount(0.0),
        })
    }

    /// Refuses a laser whose sweep does not go along the floor: that of the first of these `bases` which it hangs from; where there is none,
    /// of the frame that all others hang from.
    pub fn check_level(&self, bases: &[&str], laser: &str) -> Result<(), TiltedMount> {
        let carriers = self.ancestors(laser);
        let is_base = |(frame, _): &&(&str, Isometry3<f64>)| bases.iter().any(|base| frame_name(base) == *frame);
        let carrier = carriers.iter().find(is_base).or(carriers.last());
        carrier.map_or(Ok(()), |(frame, frame_from_laser)| Mount::of(frame_from_laser).check_level(frame, laser))
    }

    /// The place of `inner` in the frame `outer`, when they are connected without any of the frames that either is `moving` in.
    pub fn fixed(&self, outer: &str, inner: &str, moving: &[&str]) -> Option<Isometry3<f64>> {
        let (of_outer, of_inner) = (self.ancestors(outer), self.ancestors(inner));
        let meets = |(frame, _): &&(&str, Isometry3<f64>)| of_inner.iter().any(|(other, _)| other == frame);
        let &(meeting, meeting_from_outer) = of_outer.iter().find(meets)?;
        let &(_, meeting_from_inner) = of_inner.iter().find(|(frame, _)| *frame == meeting)?;
        let up_to_meeting = |chain: &[(&str, Isometry3<f64>)]| {
            let below = chain.iter().take_while(|(frame, _)| *frame != meeting);
            below.map(|(frame, _)| *frame).chain([meeting]).any(|frame| moving.contains(&frame))
        };
        let is_loose = up_to_meeting(&of_outer) || up_to_meeting(&of_inner);
        (!is_loose).then(|| meeting_from_outer.inverse() * meeting_from_inner)
    }

    /// A frame and those that it hangs from, each with the place of the frame in it.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<(&'a str, Isometry3<f64>)> {
        let first = (frame_name(frame), Isometry3::identity());
        let up = |(frame, from_start): &(&'a str, Isometry3<f64>)| {
            self.parents.get(*frame).map(|link| (link.parent.as_str(), link.last * from_start))
        };
        std::iter::successors(Some(first), up).take(MAX_CHAIN).collect()
    }

    /// The frame that all that `frame` hangs from hang from, and the frame's place in it.
    fn root<'a>(&'a self, frame: &'a str, place: impl Fn(&Link) -> Isometry3<f64>) -> Option<(&'a str, Isometry3<f64>)> {
        let mut frame = frame_name(frame);
        let mut from_start = Isometry3::identity();
        for _ in 0..MAX_CHAIN {
            let Some(link) = self.parents.get(frame) else { return Some((frame, from_start)) };
            from_start = place(link) * from_start;
            frame = &link.parent;
        }
        None
    }
}

/// tf2 knows no leading slash, older nodes write one.
pub fn frame_name(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// The motion in space of a message; `None`: it is none.
pub fn rigid_motion(place: [f64; 3], rotation: &geometry_msgs::Quaternion) -> Option<Isometry3<f64>> {
    let [x, y, z] = place;
    let rotation = UnitQuaternion::try_new(Quaternion::new(rotation.w, rotation.x, rotation.y, rotation.z), 1e-3)?;
    let isometry = Isometry3::from_parts(Translation3::new(x, y, z), rotation);
    let is_rigid = rotation.coords.iter().all(|v| v.is_finite()) && place.iter().all(|v| v.abs() <= FARTHEST);
    is_rigid.then_some(isometry)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::std_msgs::Header;

    /// Parent, child, and how far ahead of the parent the child is, m.
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
    fn a_mount_that_moves_is_carried_on_to_the_scan() {
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
    fn frames_are_fixed_to_one_another_unless_one_moves_in_between() {
        let tree = tree(&[
            ("map", "odom", 5.0),
            ("odom", "base_footprint", 7.0),
            ("base_footprint", "base_link", 0.1),
            ("base_link", "camera", 0.3),
            ("camera_odom", "camera_pose", 2.0),
            ("map", "camera_odom", 1.0),
        ]);
        let ahead = |outer, inner| tree.fixed(outer, inner, &["odom", "map"]).map(|place| place.translation.x);
        assert!((ahead("base_footprint", "/base_link").unwrap() - 0.1).abs() < 1e-12);
        assert!((ahead("camera", "base_link").unwrap() + 0.3).abs() < 1e-12);
        assert!((ahead("camera", "base_footprint").unwrap() + 0.4).abs() < 1e-12);
        assert_eq!(ahead("camera_pose", "base_link"), None, "only through the map");
        assert_eq!(ahead("nowhere", "base_link"), None);
    }
}
