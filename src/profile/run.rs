//! One run: the whole bag through the application with one configuration, every answer compared with the truth.

use std::sync::Arc;

use super::ProfileError;
use super::variant::Variant;
use crate::anytime::clock::Clock;
use crate::anytime::cost_model::CostModel;
use crate::anytime::mode::Conditions;
use crate::app::localizer::Localizer;
use crate::app::{App, Estimate};
use crate::config::Config;
use crate::evaluation::association::{MatchedPose, associate};
use crate::evaluation::ate::ate;
use crate::evaluation::report::Comparison;
use crate::evaluation::rpe::rpe;
use crate::evaluation::trajectory::{StampedPose, Trajectory};
use crate::geometry::{Point, Pose2};
use crate::io::bag::Bag;
use crate::io::contract_schedule::ContractSchedule;
use crate::map::grid::OccupancyGrid;
use crate::matching::IterationTrace;
use crate::replay::localize::{Answer, localize};
use crate::replay::map_sketch::MapSketch;
use crate::replay::{Source, Topics, microseconds, replay};
use crate::time::Stamp;

/// Matches whose descent is kept.
const KEPT_DESCENTS: u64 = 200;

/// The data of a study.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// The drive.
    pub bag: &'a Bag,
    /// What is read of it.
    pub topics: &'a Topics,
    /// What its answers are compared with.
    pub truth: &'a Trajectory,
    /// The map that the particle filter goes by, in the frame of the truth; `None`: without it there is none.
    pub map: Option<&'a OccupancyGrid>,
}

/// The answer to one scan, and how good it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanRecord {
    /// The scan's stamp.
    pub stamp: Stamp,
    /// The pose answered.
    pub map_from_base: Pose2,
    /// Whether it is by a match (or the first one), not a prediction for want of one.
    pub matched: bool,
    /// From the scan's arrival to its answer, us; `None` where the particle filter passed it over.
    pub delay_us: Option<f64>,
    /// Iterations made.
    pub iterations: u32,
    /// Rays that took part, summed over the iterations.
    pub rays: u64,
    /// Mean absolute error of the last iteration's inliers, m; `None` when there was no match.
    pub mean_residual: Option<f64>,
    /// What the estimator found.
    pub conditions: Option<Conditions>,
    /// The aligned pose seen from the true one; `None` where no truth is near in time.
    pub error: Option<Pose2>,
}

/// What a run has found.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Every scan, in order.
    pub scans: Vec<ScanRecord>,
    /// The alignment of the errors: that of the ATE.
    pub truth_from_map: Pose2,
    /// Drift per metre of the true path, root mean square: m and rad. `None` on paths of less than a metre.
    pub drift: Option<(f64, f64)>,
    /// The mean residual before each iteration, m, of a sample of the matches.
    pub descents: Vec<Vec<f64>>,
    /// Points of the scans, m, in the map frame; none unless asked for.
    pub scan_points: Vec<Point>,
    /// Beams of the first scan.
    pub beams: usize,
    /// What work was learned to cost, at the end; the particle filter's is not told.
    pub costs: Option<CostModel>,
}

/// Runs the bag through a variant. `keep_points`: collect points of the scans for a map.
pub fn run(
    input: Input,
    variant: Variant,
    config: &Config,
    clock: &Arc<dyn Clock>,
    keep_points: bool,
    on_message: impl FnMut(),
) -> Result<Run, ProfileError> {
    let mut run = match (variant, input.map) {
        (Variant::Filter, Some(map)) => localize_run(input, map, config, clock, on_message)?,
        _ => match_run(input, config, clock, keep_points, on_message)?,
    };
    run.compare(input.truth)?;
    Ok(run)
}

/// By the particle filter, from the first true pose on.
fn localize_run(
    input: Input,
    map: &OccupancyGrid,
    config: &Config,
    clock: &Arc<dyn Clock>,
    on_message: impl FnMut(),
) -> Result<Run, ProfileError> {
    let mut localizer = Localizer::new(map.clone(), config, Arc::clone(clock))?;
    if localizer.contract().time_budget.is_some() {
        localizer.warm_up();
    }
    if config.localization.initial_pose.is_none() {
        localizer.start_at(&input.truth.ends().0.pose, None);
    }
    let mut run = Run::default();
    localize::<ProfileError>(input.bag, input.topics, &mut localizer, &**clock, on_message, |answer, scan| {
        if run.scans.is_empty() {
            run.beams = scan.beams(&config.cloud);
        }
        run.scans.extend(localized(answer));
        Ok(())
    })?;
    Ok(run)
}

/// The record of a scan that was of use, or was passed over.
fn localized(answer: &Answer) -> Option<ScanRecord> {
    let record = |stamp, map_from_base| ScanRecord {
        stamp,
        map_from_base,
        matched: true,
        delay_us: None,
        iterations: 0,
        rays: 0,
        mean_residual: None,
        conditions: None,
        error: None,
    };
    match answer {
        Answer::Between { stamp, map_from_base } => Some(record(*stamp, *map_from_base)),
        Answer::Fix(fix) => fix.belief.as_ref().ok().map(|belief| ScanRecord {
            matched: belief.beams > 0,
            delay_us: Some(microseconds(fix.elapsed)),
            rays: (belief.particles * belief.beams) as u64,
            conditions: Some(belief.conditions()),
            ..record(fix.stamp, belief.map_from_base)
        }),
    }
}

fn match_run(
    input: Input,
    config: &Config,
    clock: &Arc<dyn Clock>,
    keep_points: bool,
    on_message: impl FnMut(),
) -> Result<Run, ProfileError> {
    let mut app = App::new(config, Arc::clone(clock))?;
    if app.contract().time_budget.is_some() {
        app.warm_up()?; // without a budget nothing asks for costs
    }
    let mut sketch = MapSketch::default();
    let mut run = Run::default();
    let scans = input.bag.message_count(Some(&[&input.topics.scan]));
    let every = usize::try_from(scans.div_ceil(KEPT_DESCENTS)).unwrap_or(1).max(1);
    let source = Source { bag: input.bag, topics: input.topics, schedule: &ContractSchedule::default() };
    replay::<ProfileError>(&source, &mut app, &**clock, on_message, |message, estimate, app| {
        if run.scans.is_empty() {
            run.beams = message.beams(&config.cloud);
        }
        if run.scans.len().is_multiple_of(every) && !app.iterations().is_empty() {
            run.descents.push(app.iterations().iter().map(|iteration| iteration.mean_residual).collect());
        }
        if keep_points {
            sketch.add(message, estimate, app);
        }
        run.scans.push(record(estimate, app.iterations()));
        Ok(())
    })?;
    run.scan_points = sketch.points().to_vec();
    run.costs = Some(app.costs().clone());
    Ok(run)
}

fn record(estimate: &Estimate, iterations: &[IterationTrace]) -> ScanRecord {
    let registration = &estimate.registration;
    ScanRecord {
        stamp: estimate.stamp,
        map_from_base: registration.map_from_base(),
        matched: registration.outcome.is_ok(),
        delay_us: Some(microseconds(estimate.elapsed)),
        iterations: registration.refinement.map_or(0, |r| r.iterations),
        rays: iterations.iter().map(|iteration| u64::from(iteration.rays)).sum(),
        mean_residual: registration.refinement.map(|r| r.mean_residual),
        conditions: estimate.conditions(),
        error: None,
    }
}

impl Run {
    /// The trajectory answered.
    pub fn trajectory(&self) -> Result<Trajectory, ProfileError> {
        let poses = self.scans.iter().map(|scan| StampedPose { stamp: scan.stamp, pose: scan.map_from_base });
        Ok(Trajectory::new(poses.collect())?)
    }

    /// Fills in the errors, as `anytime evaluate` finds them: after the rigid motion that lays the trajectory onto the truth.
    fn compare(&mut self, truth: &Trajectory) -> Result<(), ProfileError> {
        let matched = associate(&self.trajectory()?, truth, Comparison::default().max_dt)?;
        let Some(ate) = ate(&matched) else { return Ok(()) };
        let truth_of = |stamp: Stamp| -> Option<&MatchedPose> {
            matched.binary_search_by_key(&stamp, |m| m.stamp).ok().and_then(|i| matched.get(i))
        };
        for scan in &mut self.scans {
            let pair = truth_of(scan.stamp).map(|m| MatchedPose { estimate: scan.map_from_base, ..*m });
            scan.error = pair.map(|pair| ate.error(&pair));
        }
        self.truth_from_map = ate.truth_from_estimate;
        self.drift = rpe(&matched, 1.0).map(|drift| (drift.trans_m.rmse, drift.rot_deg.rmse.to_radians()));
        Ok(())
    }
}
