//! The relations metric: errors of motions that are known well, wherever the trajectory as a whole has gone.
//!
//! R. Kuemmerle, B. Steder, C. Dornhege, M. Ruhnke, G. Grisetti, C. Stachniss, A. Kleiner: On measuring the accuracy of SLAM
//! algorithms, Autonomous Robots 27, 2009.

use super::statistics::PoseErrors;
use super::trajectory::Trajectory;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Relations up to this many seconds tell of the local drift, longer ones of closed loops.
pub const SHORT_S: f64 = 10.0;

/// A true motion between two moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// When it starts.
    pub from: Stamp,
    /// When it ends.
    pub to: Stamp,
    /// Pose of the robot at `to` seen from the robot at `from`.
    pub motion: Pose2,
}

/// Errors over relations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelationErrors {
    /// Relations with a stamp further than the tolerance from any pose; they count like the others.
    pub beyond_max_dt: usize,
    /// Errors over all relations.
    pub all: PoseErrors,
    /// Errors over those of up to [`SHORT_S`].
    pub short: Option<PoseErrors>,
    /// Errors over the longer ones.
    pub long: Option<PoseErrors>,
}

impl RelationErrors {
    /// Whether no relation has poses near both of its stamps: the figures tell nothing.
    pub fn none_met(&self) -> bool {
        self.beyond_max_dt == self.all.count
    }
}

/// The errors of `trajectory` over `relations`; `None` when there are none.
///
/// As in the authors' own program a relation's stamp takes the nearest pose, however far. Those further than `max_dt` seconds are
/// counted: when they are many, the figures tell of the trajectory's gaps.
pub fn relation_errors(trajectory: &Trajectory, relations: &[Relation], max_dt: f64) -> Option<RelationErrors> {
    let far = |stamp: Stamp| trajectory.nearest(stamp).stamp.seconds_since(stamp).abs() > max_dt;
    let errors_of = |chosen: &dyn Fn(&Relation) -> bool| {
        let errors: Vec<_> = relations.iter().filter(|r| chosen(r)).map(|r| relation_error(trajectory, r)).collect();
        PoseErrors::of(&errors)
    };
    let is_short = |r: &Relation| r.to.seconds_since(r.from).abs() <= SHORT_S;
    Some(RelationErrors {
        beyond_max_dt: relations.iter().filter(|r| far(r.from) || far(r.to)).count(),
        all: errors_of(&|_| true)?,
        short: errors_of(&is_short),
        long: errors_of(&|r| !is_short(r)),
    })
}

/// The estimated motion seen from the true one: its norms are the paper's trans(d - d*) and rot(d - d*).
fn relation_error(trajectory: &Trajectory, relation: &Relation) -> Pose2 {
    let motion = trajectory.nearest(relation.from).pose.between(&trajectory.nearest(relation.to).pose);
    relation.motion.between(&motion)
}
