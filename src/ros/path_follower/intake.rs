//! Inputs of the follower: paths and scans in the right frames, poses, and planned paths to goals.

use std::sync::Arc;

use super::PathFollowerKnobs;
use super::convert::waypoints;
use crate::anytime::ErrorEstimate;
use crate::app::{InputError, map_message, planar_pose};
use crate::control::follower::{Follower, PoseReading};
use crate::control::path::{PathError, Waypoint};
use crate::control::progress::Arrival;
use crate::geometry::{Point, Pose2};
use crate::messages::geometry_msgs::{PoseStamped, planar_covariance};
use crate::messages::nav_msgs::{OccupancyGrid, Odometry, Path};
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::scan::ScanConverter;
use crate::simulation::grid_world::GridWorld;
use crate::simulation::planner::{NoLoop, find_way};
use crate::simulation::scene::way_round;
use crate::time::Stamp;
use crate::transforms::{TransformTree, frame_name};

/// What is worth a line in the log.
pub(super) enum Remark {
    Info(String),
    Warning(String),
}

/// Messages on their way to the follower.
pub(super) struct Intake {
    pub(super) follower: Follower,
    knobs: PathFollowerKnobs,
    transforms: TransformTree,
    converter: ScanConverter,
    /// The frame that the poses are in, once there is one.
    pose_frame: Option<String>,
    /// A path whose frame is not known yet.
    waiting: Option<Path>,
    world: Option<Arc<GridWorld>>,
    /// The way round the map, until it is known which way the car looks.
    round: Option<Vec<Waypoint>>,
    /// Last known pose of the car.
    pose: Option<Pose2>,
}

impl Intake {
    pub(super) fn new(follower: Follower, knobs: PathFollowerKnobs) -> Self {
        Self {
            follower,
            knobs,
            transforms: TransformTree::default(),
            converter: ScanConverter::default(),
            pose_frame: None,
            waiting: None,
            world: None,
            round: None,
            pose: None,
        }
    }

    /// The frame of the poses.
    pub(super) fn frame(&self) -> &str {
        self.pose_frame.as_deref().unwrap_or(&self.knobs.map_frame)
    }

    pub(super) fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let count = self.transforms.add(message);
        if count == 0 { Ok(()) } else { Err(InputError::BadTransforms { count }) }
    }

    pub(super) fn on_pose(&mut self, message: &Odometry) -> Result<(), String> {
        let pose = planar_pose(&message.pose.pose).map_err(|error| error.to_string())?;
        let covariance = planar_covariance(&message.pose.covariance);
        let twist = &message.twist.twist;
        let is_told = twist.linear.x.is_finite() && (twist.linear.x != 0.0 || twist.angular.z != 0.0);
        self.pose_frame = Some(frame_name(&message.header.frame_id).into());
        self.pose = Some(pose);
        self.follower.on_pose(PoseReading {
            stamp: message.header.stamp.into(),
            pose,
            speed: is_told.then_some(twist.linear.x),
            deviation: ErrorEstimate::of_covariance(&covariance).translation,
        });
        Ok(())
    }

    pub(super) fn on_scan(&mut self, message: &LaserScan) -> Result<(), String> {
        let (base, laser) = (&self.knobs.base_frame, &message.header.frame_id);
        let mount = self.transforms.laser_mount(base, laser, message.header.stamp.into(), self.knobs.laser_in_base);
        let mount = mount.ok_or_else(|| {
            format!("where '{laser}' is on '{base}' is not known from /tf: no emergency brake (or set laser_in_base)")
        })?;
        mount.check_level(base, laser).map_err(|error| error.to_string())?;
        let scan = self.converter.convert(message, mount.upside_down).map_err(|error| error.to_string())?;
        let transform = mount.base_from_laser.transform();
        let points: Vec<Point> = (0..scan.len()).filter_map(|ray| scan.point(ray)).map(|point| transform.apply(point)).collect();
        self.follower.on_scan(message.header.stamp.into(), points);
        Ok(())
    }

    /// A path, in whatever frame. Where the way from there to the frame of the poses is not known yet, it waits.
    pub(super) fn on_path(&mut self, message: &Path) -> Option<Remark> {
        let frame = frame_name(&message.header.frame_id).to_owned();
        let Some(pose_from_path) = self.pose_from(&frame) else {
            let remark =
                format!("path: it is in '{frame}', poses are in '{}', and /tf does not say how they lie: it waits", self.frame());
            self.waiting = Some(message.clone());
            return Some(Remark::Warning(remark));
        };
        self.waiting = None;
        self.take(&waypoints(message, &pose_from_path), message.header.stamp.into())
    }

    /// The path that waits, if it can be had now.
    pub(super) fn retry(&mut self) -> Option<Remark> {
        let frame = frame_name(&self.waiting.as_ref()?.header.frame_id).to_owned();
        self.pose_from(&frame)?;
        self.waiting.take().and_then(|path| self.on_path(&path))
    }

    /// The path of these points, in the frame of the poses.
    pub(super) fn take(&mut self, waypoints: &[Waypoint], stamp: Stamp) -> Option<Remark> {
        match self.follower.on_path(waypoints, stamp) {
            Ok(Arrival::Taken) => {
                let path = self.follower.progress()?.path();
                let kind = if path.is_closed() { "closed" } else { "open" };
                Some(Remark::Info(format!("follows a path of {:.1} m, {kind}", path.length())))
            }
            Ok(Arrival::Same) => None,
            Ok(Arrival::Older) => Some(Remark::Warning("path: it is older than the one followed, and ignored".into())),
            Err(problem @ PathError::NotFinite { .. }) => {
                Some(Remark::Warning(format!("path: refused: {problem}; the one before stays")))
            }
            Err(problem) => Some(Remark::Warning(format!("path: {problem}: the car stops"))),
        }
    }

    /// The map to plan on. With `drive_round`, a way round it is the path from the first pose on.
    pub(super) fn set_map(&mut self, grid: crate::map::grid::OccupancyGrid) -> Result<Option<Remark>, NoLoop> {
        let world = GridWorld::new(grid);
        let way = if self.knobs.drive_round { Some(way_round(&world)?) } else { None };
        self.world = Some(Arc::new(world));
        self.round = way.map(|way| way.points().iter().map(|&point| Waypoint { point, speed: None }).collect());
        Ok(self.begin_round())
    }

    /// Takes the way round, older than any path that comes, as soon as it is known which way the car looks.
    pub(super) fn begin_round(&mut self) -> Option<Remark> {
        let pose = self.pose?;
        let round = in_direction_of(&pose, self.round.take()?);
        self.take(&round, Stamp::default())
    }

    pub(super) fn on_map(&mut self, message: &OccupancyGrid) -> Result<(), String> {
        let grid = map_message::grid(message).map_err(|error| error.to_string())?;
        self.world = Some(Arc::new(GridWorld::new(grid)));
        Ok(())
    }

    /// Plans the way to a goal on the map.
    pub(super) fn on_goal(&mut self, message: &PoseStamped, from: Option<Pose2>, now: Stamp) -> Result<Option<Remark>, String> {
        let goal = planar_pose(&message.pose).map_err(|error| error.to_string())?;
        let world = self.world.clone().ok_or("there is no map to plan on (topic map)")?;
        let from = from.ok_or("where the car is is not known yet")?;
        let frame = self.knobs.map_frame.clone();
        let pose_from_map = self.pose_from(&frame).ok_or_else(|| format!("/tf does not say where '{frame}' is"))?;
        let pose_from_goal = self.pose_from(frame_name(&message.header.frame_id)).ok_or("/tf does not know the goal's frame")?;
        let map_from_pose = pose_from_map.inverse();
        let (begin, end) = ((map_from_pose * from).translation(), (map_from_pose * pose_from_goal * goal).translation());
        let way = find_way(&world, begin, end).map_err(|error| error.to_string())?;
        let transform = pose_from_map.transform();
        let waypoints: Vec<_> = way.iter().map(|&point| Waypoint { point: transform.apply(point), speed: None }).collect();
        Ok(self.take(&waypoints, now))
    }

    /// How a frame lies in that of the poses.
    fn pose_from(&self, frame: &str) -> Option<Pose2> {
        if frame.is_empty() || frame == self.frame() {
            return Some(Pose2::IDENTITY);
        }
        self.transforms.mount(self.frame(), frame).map(|mount| mount.base_from_laser)
    }
}

/// A loop is as good either way round: this one the way that the car looks where it is next to it.
fn in_direction_of(pose: &Pose2, mut round: Vec<Waypoint>) -> Vec<Waypoint> {
    let distance = |waypoint: &Waypoint| (waypoint.point - pose.translation()).norm();
    let nearest = (0..round.len()).min_by(|&a, &b| distance(&round[a]).total_cmp(&distance(&round[b]))).unwrap_or(0);
    let count = round.len().max(1);
    if let (Some(here), Some(next)) = (round.get(nearest), round.get((nearest + 1) % count)) {
        let (sin, cos) = pose.theta.sin_cos();
        if (next.point - here.point).dot(&Point::new(cos, sin)) < 0.0 {
            round.reverse();
        }
    }
    round
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_is_driven_the_way_the_car_looks() {
        let at = |x: f64, y: f64| Waypoint { point: Point::new(x, y), speed: None };
        let square = [at(0.0, 0.0), at(4.0, 0.0), at(4.0, 4.0), at(0.0, 4.0)];
        let first = |pose: Pose2| in_direction_of(&pose, square.to_vec())[0].point;
        assert_eq!(first(Pose2::new(0.5, 0.1, 0.1)), square[0].point);
        assert_eq!(first(Pose2::new(0.5, 0.1, 3.0)), square[3].point);
        assert!(in_direction_of(&Pose2::IDENTITY, Vec::new()).is_empty());
    }
}
