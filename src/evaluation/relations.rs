//! The relations metric: errors of relative motions whose true values are known, independent of the trajectory's global error.
//!
//! R. Kuemmerle, B. Steder, C. Dornhege, M. Ruhnke, G. Grisetti, C. Stachniss, A. Kleiner: On measuring the accuracy of SLAM
//! algorithms, Autonomous Robots 27, 2009.

use super::statistics::PoseErrors;
use super::trajectory::Trajectory;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Maximum duration of a short relation, s. Short relations measure the local drift, long ones the loop closures.
pub const SHORT_S: f64 = 10.0;

/// The true motion between two stamps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// Start of the motion.
    pub from: Stamp,
    /// End of the motion.
    pub to: Stamp,
    /// Pose of the robot at `to`, in the frame of the robot at `from`.
    pub motion: Pose2,
}

/// Errors of the relations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelationErrors {
    /// Number of relations with a stamp further than the tolerance from any pose. Their errors are included.
    pub beyond_max_dt: usize,
    /// Errors of all relations.
    pub all: PoseErrors,
    /// Errors of the relations up to [`SHORT_S`].
    pub short: Option<PoseErrors>,
    /// Errors of the longer relations.
    pub long: Option<PoseErrors>,
}

impl RelationErrors {
    /// Whether no relation has poses near both of its stamps. The errors are then meaningless.
    pub fn all_beyond_max_dt(&self) -> bool {
        self.beyond_max_dt == self.all.count
    }
}

/// Computes the errors of `trajectory` for `relations`; `None` if there are no relations.
///
/// As in the authors' own program, each stamp uses the nearest pose, however far away. Relations with a pose further away than `max_dt`
/// seconds are counted: if there are many, the errors reflect the gaps of the trajectory.
pub fn relation_errors(trajectory: &Trajectory, relations: &[Relation], max_dt: f64) -> Option<RelationErrors> {
    let far = |stamp: Stamp| trajectory.nearest(stamp).stamp.seconds_since(stamp).abs() > max_dt;
    let errors_of = |is_selected: &dyn Fn(&Relation) -> bool| {
        let errors: Vec<_> = relations.iter().filter(|r| is_selected(r)).map(|r| relation_error(trajectory, r)).collect();
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

/// The estimated motion relative to the true one; its norms are the paper's trans(d - d*) and rot(d - d*).
fn relation_error(trajectory: &Trajectory, relation: &Relation) -> Pose2 {
    let motion = trajectory.nearest(relation.from).pose.between(&trajectory.nearest(relation.to).pose);
    relation.motion.between(&motion)
}
