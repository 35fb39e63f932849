//! One run: replays the whole bag with one configuration and compares every answer with the ground truth.

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
use crate::replay::localize::{ScanOutcome, localize};
use crate::replay::map_sketch::MapSketch;
use crate::replay::{Source, Topics, microseconds, replay};
use crate::time::Stamp;

/// Maximum number of matches whose residuals by iteration are kept.
const MAX_CONVERGENCE_SAMPLES: u64 = 200;

/// The data of a study.
#[derive(Clone, Copy)]
pub struct StudyData<'a> {
    /// The recorded drive.
    pub bag: &'a Bag,
    /// The topics to read.
    pub topics: &'a Topics,
    /// Ground truth for the answers.
    pub truth: &'a Trajectory,
    /// The map for the particle filter, in the frame of the ground truth; `None`: the particle filter is not run.
    pub map: Option<&'a OccupancyGrid>,
}

/// The answer to one scan, and its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanRecord {
    /// The scan's stamp.
    pub stamp: Stamp,
    /// The estimated pose.
    pub map_from_base: Pose2,
    /// Whether the pose comes from a match (or is the first one), not only from a prediction.
    pub matched: bool,
    /// Time from the arrival of the scan to its answer, us; `None` if the particle filter skipped the scan.
    pub delay_us: Option<f64>,
    /// Number of iterations.
    pub iterations: u32,
    /// Rays used, summed over the iterations.
    pub rays: u64,
    /// Mean absolute residual of the last iteration's inliers, m; `None` without a match.
    pub mean_residual: Option<f64>,
    /// Conditions of the answer: properties of the scan that its error depends on.
    pub conditions: Option<Conditions>,
    /// The aligned pose relative to the true pose; `None` if no ground truth is close in time.
    pub error: Option<Pose2>,
}

/// Results of a run.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// All scans, in order.
    pub scans: Vec<ScanRecord>,
    /// The alignment of the trajectory for the errors (ATE).
    pub truth_from_map: Pose2,
    /// RMS drift per metre of the true path, m and rad. `None` on paths shorter than a metre.
    pub drift: Option<(f64, f64)>,
    /// Mean residual before each iteration, m, for a sample of the matches.
    pub convergence: Vec<Vec<f64>>,
    /// Points of the scans in the map frame, m; empty unless requested.
    pub scan_points: Vec<Point>,
    /// Number of beams of the first scan.
    pub beams: usize,
    /// Learned costs at the end of the run; `None` for the particle filter.
    pub costs: Option<CostModel>,
}

/// Replays the bag with a variant. `keep_points`: collect the points of the scans for a map.
pub fn run(
    input: StudyData,
    variant: Variant,
    config: &Config,
    clock: &Arc<dyn Clock>,
    keep_points: bool,
    on_message: impl FnMut(),
) -> Result<Run, ProfileError> {
    let mut run = match (variant, input.map) {
        (Variant::Filter, Some(map)) => run_localizer(input, map, config, clock, on_message)?,
        _ => run_matcher(input, config, clock, keep_points, on_message)?,
    };
    run.add_errors(input.truth)?;
    Ok(run)
}

/// Runs the particle filter, initialized at the first true pose.
fn run_localizer(
    input: StudyData,
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
        run.scans.extend(localizer_record(answer));
        Ok(())
    })?;
    Ok(run)
}

/// Record of a scan of the particle filter; `None` if the scan was rejected.
fn localizer_record(answer: &ScanOutcome) -> Option<ScanRecord> {
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
        ScanOutcome::Skipped { stamp, map_from_base } => Some(record(*stamp, *map_from_base)),
        ScanOutcome::Fix(fix) => fix.belief.as_ref().ok().map(|belief| ScanRecord {
            matched: belief.beams > 0,
            delay_us: Some(microseconds(fix.elapsed)),
            rays: (belief.particles * belief.beams) as u64,
            conditions: Some(belief.conditions()),
            ..record(fix.stamp, belief.map_from_base)
        }),
    }
}

fn run_matcher(
    input: StudyData,
    config: &Config,
    clock: &Arc<dyn Clock>,
    keep_points: bool,
    on_message: impl FnMut(),
) -> Result<Run, ProfileError> {
    let mut app = App::new(config, Arc::clone(clock))?;
    if app.contract().time_budget.is_some() {
        app.warm_up()?; // costs are only used with a time budget
    }
    let mut sketch = MapSketch::default();
    let mut run = Run::default();
    let scans = input.bag.message_count(Some(&[&input.topics.scan]));
    let every = usize::try_from(scans.div_ceil(MAX_CONVERGENCE_SAMPLES)).unwrap_or(1).max(1);
    let source = Source { bag: input.bag, topics: input.topics, schedule: &ContractSchedule::default() };
    replay::<ProfileError>(&source, &mut app, &**clock, on_message, |message, estimate, app| {
        if run.scans.is_empty() {
            run.beams = message.beams(&config.cloud);
        }
        if run.scans.len().is_multiple_of(every) && !app.iterations().is_empty() {
            run.convergence.push(app.iterations().iter().map(|iteration| iteration.mean_residual).collect());
        }
        if keep_points {
            sketch.add(message, estimate, app);
        }
        run.scans.push(matcher_record(estimate, app.iterations()));
        Ok(())
    })?;
    run.scan_points = sketch.points().to_vec();
    run.costs = Some(app.costs().clone());
    Ok(run)
}

fn matcher_record(estimate: &Estimate, iterations: &[IterationTrace]) -> ScanRecord {
    let registration = &estimate.registration;
    ScanRecord {
        stamp: estimate.stamp,
        map_from_base: registration.map_from_base(),
        matched: registration.outcome.is_ok(),
        delay_us: Some(microseconds(estimate.elapsed)),
        iterations: registration.refinement.map_or(0, |r| r.iterations),
        rays: iterations.iter().map(|iteration| u64::from(iteration.rays)).sum(),
        mean_residual: registration.refinement.map(|r| r.last.mean_residual),
        conditions: estimate.conditions(),
        error: None,
    }
}

impl Run {
    /// The estimated trajectory.
    pub fn trajectory(&self) -> Result<Trajectory, ProfileError> {
        let poses = self.scans.iter().map(|scan| StampedPose { stamp: scan.stamp, pose: scan.map_from_base });
        Ok(Trajectory::new(poses.collect())?)
    }

    /// Fills in the errors after rigid alignment to the ground truth, as `anytime evaluate` computes them.
    fn add_errors(&mut self, truth: &Trajectory) -> Result<(), ProfileError> {
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
