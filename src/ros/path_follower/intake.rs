//! The follower's inputs: poses, paths and scans transformed to the frame it needs, and paths planned to goals.

use std::sync::Arc;

use super::PathFollowerKnobs;
use super::convert::waypoints;
use crate::anytime::ErrorEstimate;
use crate::app::{InputError, map_message, planar_pose};
use crate::control::follower::{Follower, PoseReading};
use crate::control::path::{PathError, Waypoint};
use crate::control::progress::PathUpdate;
use crate::geometry::{Point, Pose2};
use crate::messages::geometry_msgs::{PoseStamped, planar_covariance};
use crate::messages::nav_msgs::{OccupancyGrid, Odometry, Path};
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::scan::ScanConverter;
use crate::simulation::grid_world::GridWorld;
use crate::simulation::planner::{NoLoop, find_path};
use crate::simulation::scene::plan_loop;
use crate::time::Stamp;
use crate::transforms::{TransformTree, frame_name};

/// A line for the log.
pub(super) enum Remark {
    Info(String),
    Warning(String),
}

/// Prepares messages for the follower.
pub(super) struct Intake {
    pub(super) follower: Follower,
    knobs: PathFollowerKnobs,
    transforms: TransformTree,
    converter: ScanConverter,
    /// Frame of the poses, once a pose has arrived.
    pose_frame: Option<String>,
    /// A path in a frame to which there is no transform yet.
    waiting: Option<Path>,
    world: Option<Arc<GridWorld>>,
    /// The loop through the map, until the heading of the car is known.
    pending_loop: Option<Vec<Waypoint>>,
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
            pending_loop: None,
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
        let is_given = twist.linear.x.is_finite() && (twist.linear.x != 0.0 || twist.angular.z != 0.0);
        self.pose_frame = Some(frame_name(&message.header.frame_id).into());
        self.pose = Some(pose);
        self.follower.on_pose(PoseReading {
            stamp: message.header.stamp.into(),
            pose,
            speed: is_given.then_some(twist.linear.x),
            deviation: ErrorEstimate::of_covariance(&covariance).translation,
        });
        Ok(())
    }

    pub(super) fn on_scan(&mut self, message: &LaserScan) -> Result<(), String> {
        let (base, laser) = (&self.knobs.base_frame, &message.header.frame_id);
        let mount = self.transforms.laser_mount(base, laser, message.header.stamp.into(), self.knobs.laser_in_base);
        let mount = mount.ok_or_else(|| {
            format!("no transform from '{base}' to '{laser}' on /tf, so no emergency braking: publish it or set laser_in_base")
        })?;
        mount.check_level(base, laser).map_err(|error| error.to_string())?;
        let scan = self.converter.convert(message, mount.upside_down).map_err(|error| error.to_string())?;
        let transform = mount.base_from_laser.transform();
        let points: Vec<Point> = (0..scan.len()).filter_map(|ray| scan.point(ray)).map(|point| transform.apply(point)).collect();
        self.follower.on_scan(message.header.stamp.into(), points);
        Ok(())
    }

    /// Handles a path in any frame. If there is no transform to the frame of the poses yet, the path waits for it.
    pub(super) fn on_path(&mut self, message: &Path) -> Option<Remark> {
        let frame = frame_name(&message.header.frame_id).to_owned();
        let Some(pose_from_path) = self.pose_from(&frame) else {
            let remark = format!(
                "no transform on /tf from its frame '{frame}' to the frame '{}' of the poses: waiting for it",
                self.frame()
            );
            self.waiting = Some(message.clone());
            return Some(Remark::Warning(remark));
        };
        self.waiting = None;
        self.take(&waypoints(message, &pose_from_path), message.header.stamp.into())
    }

    /// Retries the waiting path, if there is a transform now.
    pub(super) fn retry(&mut self) -> Option<Remark> {
        let frame = frame_name(&self.waiting.as_ref()?.header.frame_id).to_owned();
        self.pose_from(&frame)?;
        self.waiting.take().and_then(|path| self.on_path(&path))
    }

    /// Passes a path in the frame of the poses to the follower.
    pub(super) fn take(&mut self, waypoints: &[Waypoint], stamp: Stamp) -> Option<Remark> {
        match self.follower.on_path(waypoints, stamp) {
            Ok(PathUpdate::Accepted) => {
                let path = self.follower.progress()?.path();
                let kind = if path.is_closed() { "closed" } else { "open" };
                Some(Remark::Info(format!("following a path of {:.1} m ({kind})", path.length())))
            }
            Ok(PathUpdate::Unchanged) => None,
            Ok(PathUpdate::Outdated) => Some(Remark::Warning("ignored, as it is older than the current one".into())),
            Err(problem @ PathError::NotFinite { .. }) => {
                Some(Remark::Warning(format!("rejected: {problem}; keeping the current path")))
            }
            Err(problem) => Some(Remark::Warning(format!("{problem}: the car stops"))),
        }
    }

    /// Sets the map to plan on. With `drive_round`, a loop through it becomes the path at the first pose.
    pub(super) fn set_map(&mut self, grid: crate::map::grid::OccupancyGrid) -> Result<Option<Remark>, NoLoop> {
        let world = GridWorld::new(grid);
        let route = if self.knobs.drive_round { Some(plan_loop(&world)?) } else { None };
        self.world = Some(Arc::new(world));
        self.pending_loop = route.map(|route| route.points().iter().map(|&point| Waypoint { point, speed: None }).collect());
        Ok(self.start_loop())
    }

    /// Follows the loop through the map as soon as the heading of the car is known. Any path that arrives later replaces it.
    pub(super) fn start_loop(&mut self) -> Option<Remark> {
        let pose = self.pose?;
        let waypoints = oriented_along(&pose, self.pending_loop.take()?);
        self.take(&waypoints, Stamp::default())
    }

    pub(super) fn on_map(&mut self, message: &OccupancyGrid) -> Result<(), String> {
        let grid = map_message::grid(message).map_err(|error| error.to_string())?;
        self.world = Some(Arc::new(GridWorld::new(grid)));
        Ok(())
    }

    /// Plans a path to a goal on the map.
    pub(super) fn on_goal(&mut self, message: &PoseStamped, from: Option<Pose2>, now: Stamp) -> Result<Option<Remark>, String> {
        let goal = planar_pose(&message.pose).map_err(|error| error.to_string())?;
        let world = self.world.clone().ok_or("there is no map to plan on: publish one on the topic map, or set map_file")?;
        let from = from.ok_or("the pose of the car is not known yet")?;
        let frame = self.knobs.map_frame.clone();
        let pose_from_map =
            self.pose_from(&frame).ok_or_else(|| format!("no transform from the poses to the map frame '{frame}' on /tf"))?;
        let pose_from_goal = self
            .pose_from(frame_name(&message.header.frame_id))
            .ok_or("no transform from the poses to the frame of the goal on /tf")?;
        let map_from_pose = pose_from_map.inverse();
        let (begin, end) = ((map_from_pose * from).translation(), (map_from_pose * pose_from_goal * goal).translation());
        let route = find_path(&world, begin, end).map_err(|error| error.to_string())?;
        let transform = pose_from_map.transform();
        let waypoints: Vec<_> = route.iter().map(|&point| Waypoint { point: transform.apply(point), speed: None }).collect();
        Ok(self.take(&waypoints, now))
    }

    /// The transform from the frame of the poses to `frame`.
    fn pose_from(&self, frame: &str) -> Option<Pose2> {
        if frame.is_empty() || frame == self.frame() {
            return Some(Pose2::IDENTITY);
        }
        self.transforms.mount(self.frame(), frame).map(|mount| mount.base_from_laser)
    }
}

/// Orients a loop: in the direction of the car's heading at the waypoint nearest to it.
fn oriented_along(pose: &Pose2, mut waypoints: Vec<Waypoint>) -> Vec<Waypoint> {
    let distance = |waypoint: &Waypoint| (waypoint.point - pose.translation()).norm();
    let nearest = (0..waypoints.len()).min_by(|&a, &b| distance(&waypoints[a]).total_cmp(&distance(&waypoints[b]))).unwrap_or(0);
    let count = waypoints.len().max(1);
    if let (Some(here), Some(next)) = (waypoints.get(nearest), waypoints.get((nearest + 1) % count)) {
        let (sin, cos) = pose.theta.sin_cos();
        if (next.point - here.point).dot(&Point::new(cos, sin)) < 0.0 {
            waypoints.reverse();
        }
    }
    waypoints
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_is_driven_in_the_direction_of_the_heading() {
        let at = |x: f64, y: f64| Waypoint { point: Point::new(x, y), speed: None };
        let square = [at(0.0, 0.0), at(4.0, 0.0), at(4.0, 4.0), at(0.0, 4.0)];
        let first = |pose: Pose2| oriented_along(&pose, square.to_vec())[0].point;
        assert_eq!(first(Pose2::new(0.5, 0.1, 0.1)), square[0].point);
        assert_eq!(first(Pose2::new(0.5, 0.1, 3.0)), square[3].point);
        assert!(oriented_along(&Pose2::IDENTITY, Vec::new()).is_empty());
    }
}
