//! Replays a bag through the particle filter.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

use comfy_table::{Table, presets};
use serde_json::{Value, json};

use super::failures::Failures;
use super::row::BeliefRow;
use super::{ReplayLog, Topics, decode_scan, feed, microseconds, time_percentiles};
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::NeverInterrupt;
use crate::app::ScanProcessor as _;
use crate::app::localizer::{Fix, Localizer};
use crate::app::sensed::SensorMessage;
use crate::evaluation::association::MatchedPose;
use crate::evaluation::consistency::Consistency;
use crate::evaluation::statistics::PoseErrors;
use crate::evaluation::trajectory::StampedPose;
use crate::geometry::{Pose2, PoseCovariance};
use crate::io::bag::{Bag, BagError};
use crate::localization::estimate::Belief;
use crate::time::Stamp;

/// What became of a scan.
#[derive(Clone, Debug)]
pub enum ScanOutcome {
    /// The filter processed or rejected it.
    Fix(Box<Fix>),
    /// It was skipped, because a newer scan had arrived when the timer fired.
    Skipped {
        /// Stamp of the scan.
        stamp: Stamp,
        /// Pose of the base at that time: the last estimate, extrapolated by odometry.
        map_from_base: Pose2,
    },
}

/// Replays a bag through the particle filter. Calls `on_outcome` for each scan, and `on_message` for every message read. An error
/// of `on_outcome` ends the replay. If the filter runs on a timer, the timer follows the recording times of the bag, and each
/// call processes the latest scan.
pub fn localize<E: From<BagError>>(
    bag: &Bag,
    topics: &Topics,
    localizer: &mut Localizer,
    clock: &dyn Clock,
    on_message: impl FnMut(),
    mut on_outcome: impl FnMut(&ScanOutcome, &SensorMessage) -> Result<(), E>,
) -> Result<ReplayLog, E> {
    let mut timer = localizer.config().localization.timer(Duration::ZERO);
    let mut held: Option<SensorMessage> = None;
    let mut start = None;
    let log = feed(bag, topics, localizer, on_message, |message, localizer, log| {
        let arrival = clock.now();
        let scan = match decode_scan(message) {
            Ok(scan) => scan,
            Err(error) => {
                log.add_unusable(None, &error.to_string());
                return Ok(());
            }
        };
        let since_start = message.time.seconds_since(*start.get_or_insert(message.time));
        let now = Duration::try_from_secs_f64(since_start).unwrap_or_default();
        let Some(timer) = &mut timer else { return answer(localizer, &scan, arrival, &mut on_outcome) };
        let is_due = timer.is_due(now);
        let Some(earlier) = held.replace(scan) else { return Ok(()) };
        if is_due { answer(localizer, &earlier, arrival, &mut on_outcome) } else { skip(localizer, &earlier, &mut on_outcome) }
    })?;
    if let Some(last) = held {
        skip(localizer, &last, &mut on_outcome)?;
    }
    Ok(log)
}

fn answer<E>(
    localizer: &mut Localizer,
    scan: &SensorMessage,
    arrival: Duration,
    on_outcome: &mut impl FnMut(&ScanOutcome, &SensorMessage) -> Result<(), E>,
) -> Result<(), E> {
    let fix = localizer.answer(scan, arrival, |_, _| ()).maintain(&NeverInterrupt);
    on_outcome(&ScanOutcome::Fix(Box::new(fix)), scan)
}

fn skip<E>(
    localizer: &Localizer,
    scan: &SensorMessage,
    on_outcome: &mut impl FnMut(&ScanOutcome, &SensorMessage) -> Result<(), E>,
) -> Result<(), E> {
    let stamp = scan.stamp();
    let Some(map_from_base) = localizer.extrapolated_to(stamp) else { return Ok(()) };
    on_outcome(&ScanOutcome::Skipped { stamp, map_from_base }, scan)
}

/// Errors of the poses, and whether their covariances are consistent with these.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthErrors {
    /// Errors of the poses.
    pub poses: PoseErrors,
    /// Consistency of the covariances; `None` if none of them can be inverted.
    pub consistency: Option<Consistency>,
}

/// Collects the outcomes of a replay.
#[derive(Clone, Debug, Default)]
pub struct LocalizationSummary {
    poses: Vec<StampedPose>,
    /// Poses at which the robot was localized.
    localized: Vec<StampedPose>,
    /// Covariances of these, by stamp.
    covariances: BTreeMap<Stamp, PoseCovariance>,
    elapsed: Vec<Duration>,
    skipped: usize,
    /// Sum over all scans of the fraction of beams that the map explains.
    explained: f64,
    particles: u64,
    effective: f64,
    beams: u64,
    late: usize,
    worst_overrun: Duration,
    unused: Failures,
}

impl LocalizationSummary {
    /// Counts a skipped scan.
    pub fn add_skipped(&mut self) {
        self.skipped += 1;
    }

    /// Adds the estimate for a scan. Returns its pose, if it has one.
    pub fn add(&mut self, BeliefRow { pose, covariance, report }: &BeliefRow) -> Option<StampedPose> {
        let Some(pose) = *pose else {
            self.unused.add(&report.failure, &report.reason);
            return None;
        };
        let pose = StampedPose { stamp: report.header.stamp.into(), pose };
        self.poses.push(pose);
        self.elapsed.push(report.elapsed.span());
        if report.localized {
            self.localized.push(pose);
            self.covariances.insert(pose.stamp, *covariance);
        }
        self.explained += report.explained;
        self.particles += u64::from(report.particles);
        self.effective += report.effective;
        self.beams += u64::from(report.beams);
        self.late += usize::from(!report.deadline_met);
        self.worst_overrun = self.worst_overrun.max(report.overrun.span());
        Some(pose)
    }

    /// The trajectory of the base in the map frame.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The poses of the trajectory at which the robot was localized.
    pub fn localized(&self) -> &[StampedPose] {
        &self.localized
    }

    /// Mean fraction of the beams that the map explains at the estimated pose.
    pub fn explained(&self) -> f64 {
        self.explained / self.poses.len().max(1) as f64
    }

    /// Explains why localization failed, if it did: the robot never was localized, or was lost for most of the time since it
    /// first was.
    pub fn failure(&self) -> Option<String> {
        let since = self.localized.first().map(|first| self.poses.iter().filter(|pose| pose.stamp >= first.stamp).count());
        if since.is_some_and(|since| 2 * self.localized.len() >= since) {
            return None;
        }
        let (percent, min_percent) = (100.0 * self.explained(), 100.0 * Belief::MIN_EXPLAINED);
        Some(if self.explained() < Belief::MIN_EXPLAINED {
            format!(
                "the robot was not localized: at the estimated poses, the map explains {percent:.0} % of the beams, but the \
                 right map would explain more than {min_percent:.0} %. Check the map and its scale. If they are right, give \
                 --initial-pose or a longer drive"
            )
        } else {
            "the robot was not localized: the scans fit several poses on the map. Give --initial-pose or a longer drive".into()
        })
    }

    /// A warning if the robot was lost after it had first been localized, with whether it still was at the end.
    pub fn lost(&self) -> Option<String> {
        let first = self.localized.first()?;
        let since = self.poses.iter().filter(|pose| pose.stamp >= first.stamp);
        let lost: Vec<Stamp> = since.map(|pose| pose.stamp).filter(|stamp| !self.covariances.contains_key(stamp)).collect();
        let from_start = lost.first()?.seconds_since(self.poses.first()?.stamp);
        let at_the_end =
            if lost.last() == self.poses.last().map(|pose| &pose.stamp) { ", and the last scan is one of them" } else { "" };
        Some(format!(
            "the robot was localized, but then lost at {} scans; the first is {from_start:.1} s after the start{at_the_end}",
            lost.len()
        ))
    }

    /// Reasons why scans were not used, with their numbers; empty if all were used.
    pub fn unused(&self) -> Vec<String> {
        self.unused.descriptions(self.poses.len() + self.unused.count())
    }

    /// Mean number of particles, effective number of particles, and mean number of beams.
    fn means(&self) -> (f64, f64, f64) {
        let scans = self.poses.len().max(1) as f64;
        (self.particles as f64 / scans, self.effective / scans, self.beams as f64 / scans)
    }

    /// Time from the first scan until the robot was first localized, s.
    fn seconds_to_localize(&self) -> Option<f64> {
        self.localized.first().zip(self.poses.first()).map(|(localized, first)| localized.stamp.seconds_since(first.stamp))
    }

    /// Errors of the localized poses against the truth, in the map frame and without alignment. `None` if there are no such
    /// poses.
    pub fn errors(&self, matched: &[MatchedPose]) -> Option<TruthErrors> {
        let errors: Vec<_> = matched.iter().map(|matched| matched.truth.between(&matched.estimate)).collect();
        let covariance = |matched: &MatchedPose| self.covariances.get(&matched.stamp);
        let estimates = matched.iter().filter_map(|m| Some((&m.estimate, covariance(m)?, &m.truth)));
        Some(TruthErrors { poses: PoseErrors::of(&errors)?, consistency: Consistency::of(estimates) })
    }

    /// Formats the summary as a JSON object.
    pub fn to_json(&self, errors: Option<&TruthErrors>, problems: &[String]) -> Value {
        let ([p50, p99, max], (particles, effective, beams)) = (time_percentiles(&self.elapsed), self.means());
        let consistency = errors.and_then(|errors| errors.consistency);
        json!({
            "scans": self.poses.len(),
            "passed_over": self.skipped,
            "outcome": if self.failure().is_none() { "localized" } else { "not_localized" },
            "localized": self.localized.len(),
            "localized_after_s": self.seconds_to_localize(),
            "mean_explained": self.explained(),
            "mean_particles": particles,
            "mean_effective_particles": effective,
            "mean_beams": beams,
            "deadline_misses": self.late,
            "worst_overrun_us": microseconds(self.worst_overrun),
            "time_us": {"p50": p50, "p99": p99, "max": max},
            "position_rmse_m": errors.map(|errors| errors.poses.trans_m.rmse),
            "position_max_m": errors.map(|errors| errors.poses.trans_m.max),
            "heading_rmse_deg": errors.map(|errors| errors.poses.rot_deg.rmse),
            "heading_max_deg": errors.map(|errors| errors.poses.rot_deg.max),
            "nees": consistency.map(|consistency| consistency.nees),
            "within_three_sigma": consistency.map(|consistency| consistency.positions_within),
            "unused": self.unused.counts(),
            "problems": problems,
        })
    }

    /// Formats the summary as a table.
    pub fn to_text(&self, errors: Option<&TruthErrors>, problems: &[String]) -> String {
        let ([p50, p99, max], (particles, effective, beams)) = (time_percentiles(&self.elapsed), self.means());
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.add_row(["scans", &self.poses.len().to_string()]);
        if self.skipped > 0 {
            table.add_row(["skipped", &format!("{}: a newer scan had arrived when the timer fired", self.skipped)]);
        }
        for unused in self.unused() {
            table.add_row(["unused", &unused]);
        }
        let first = self.seconds_to_localize().map_or(String::new(), |seconds| format!(", the first after {seconds:.2} s"));
        table.add_row(["localized", &format!("{} scans{first}", self.localized.len())]);
        table.add_row(["map explains", &format!("{:.0} % of the beams", 100.0 * self.explained())]);
        table.add_row(["particles", &format!("{particles:.0}, {effective:.0} of them effective; {beams:.0} beams")]);
        table.add_row(["time", &format!("p50 {p50:.0} us, p99 {p99:.0} us, max {max:.0} us")]);
        if self.late > 0 {
            let worst = microseconds(self.worst_overrun);
            table.add_row(["deadline misses", &format!("{}, worst overrun {worst:.0} us", self.late)]);
        }
        if let Some(TruthErrors { poses: PoseErrors { trans_m, rot_deg, .. }, consistency }) = errors {
            table.add_row(["position error", &format!("while localized: RMSE {:.4} m, max {:.4} m", trans_m.rmse, trans_m.max)]);
            table.add_row([
                "heading error",
                &format!("while localized: RMSE {:.4} deg, max {:.4} deg", rot_deg.rmse, rot_deg.max),
            ]);
            if let Some(Consistency { nees, positions_within, .. }) = consistency {
                let percent = 100.0 * positions_within;
                table.add_row([
                    "consistency",
                    &format!("NEES {nees:.1} (ideal: 3); {percent:.1} % of the positions within 3 sigma"),
                ]);
            }
        }
        let mut text = format!("{table}\n");
        for problem in problems {
            let _ = writeln!(text, "note: {problem}");
        }
        text
    }
}
