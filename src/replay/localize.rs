//! Replays a bag through the particle filter.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

use comfy_table::{Table, presets};
use serde_json::{Value, json};

use super::failures::Failures;
use super::row::BeliefRow;
use super::{ReplayLog, Topics, feed, microseconds, sensed};
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::Never;
use crate::app::Answering as _;
use crate::app::localizer::{Fix, Localizer};
use crate::app::sensed::Sensed;
use crate::evaluation::association::MatchedPose;
use crate::evaluation::consistency::Consistency;
use crate::evaluation::statistics::PoseErrors;
use crate::evaluation::trajectory::StampedPose;
use crate::geometry::{Pose2, PoseCovariance};
use crate::io::bag::{Bag, BagError};
use crate::localization::estimate::Belief;
use crate::quantile;
use crate::time::Stamp;

/// The outcome for a scan.
#[derive(Clone, Debug)]
pub enum Answer {
    /// The filter took it in, or could not use it.
    Fix(Box<Fix>),
    /// A newer one was there when the timer called. Where the robot was then: the last belief, carried on by odometry.
    Between {
        /// The scan's stamp.
        stamp: Stamp,
        /// The pose of the base.
        map_from_base: Pose2,
    },
}

/// Localizes a robot by a bag. `on_answer` gets the answer to each scan; `on_message` is called for every message read. An error of
/// `on_answer` ends the replay. A timer goes by the time of the bag, and each of its calls finds the latest scan.
pub fn localize<E: From<BagError>>(
    bag: &Bag,
    topics: &Topics,
    localizer: &mut Localizer,
    clock: &dyn Clock,
    on_message: impl FnMut(),
    mut on_answer: impl FnMut(&Answer, &Sensed) -> Result<(), E>,
) -> Result<ReplayLog, E> {
    let mut timer = localizer.config().localization.timer(Duration::ZERO);
    let mut held: Option<Sensed> = None;
    let mut start = None;
    let log = feed(bag, topics, localizer, on_message, |message, localizer, log| {
        let arrival = clock.now();
        let scan = match sensed(message) {
            Ok(scan) => scan,
            Err(error) => {
                log.note(None, &error.to_string());
                return Ok(());
            }
        };
        let since_start = message.time.seconds_since(*start.get_or_insert(message.time));
        let now = Duration::try_from_secs_f64(since_start).unwrap_or_default();
        let Some(timer) = &mut timer else { return answer(localizer, &scan, arrival, &mut on_answer) };
        let is_due = timer.is_due(now);
        let Some(earlier) = held.replace(scan) else { return Ok(()) };
        if is_due { answer(localizer, &earlier, arrival, &mut on_answer) } else { pass_over(localizer, &earlier, &mut on_answer) }
    })?;
    if let Some(last) = held {
        pass_over(localizer, &last, &mut on_answer)?;
    }
    Ok(log)
}

fn answer<E>(
    localizer: &mut Localizer,
    scan: &Sensed,
    arrival: Duration,
    on_answer: &mut impl FnMut(&Answer, &Sensed) -> Result<(), E>,
) -> Result<(), E> {
    let fix = localizer.answer(scan, arrival, |_, _| ()).maintain(&Never);
    on_answer(&Answer::Fix(Box::new(fix)), scan)
}

fn pass_over<E>(
    localizer: &Localizer,
    scan: &Sensed,
    on_answer: &mut impl FnMut(&Answer, &Sensed) -> Result<(), E>,
) -> Result<(), E> {
    let stamp = scan.stamp();
    let Some(map_from_base) = localizer.carried_to(stamp) else { return Ok(()) };
    on_answer(&Answer::Between { stamp, map_from_base }, scan)
}

/// How far off the poses were, and whether their covariances said so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthErrors {
    /// The errors.
    pub poses: PoseErrors,
    /// `None` where no covariance can be inverted.
    pub consistency: Option<Consistency>,
}

/// Collects the answers of a replay.
#[derive(Clone, Debug, Default)]
pub struct LocalizationSummary {
    poses: Vec<StampedPose>,
    /// Those of scans after which the robot knew where it was.
    localized: Vec<StampedPose>,
    /// How sure it was then.
    covariances: BTreeMap<Stamp, PoseCovariance>,
    elapsed: Vec<Duration>,
    between: usize,
    /// Sum of the parts of their beams that the map explained.
    explained: f64,
    particles: u64,
    effective: f64,
    beams: u64,
    late: usize,
    worst_overrun: Duration,
    unused: Failures,
}

impl LocalizationSummary {
    /// Counts a scan that was passed over.
    pub fn pass_over(&mut self) {
        self.between += 1;
    }

    /// Adds an answer; returns its pose, if it has one.
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

    /// The trajectory of the base on the map.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The part of it on which the robot knew where it was.
    pub fn localized(&self) -> &[StampedPose] {
        &self.localized
    }

    /// Part of the beams that the map explained where the robot was believed to be, on average.
    pub fn explained(&self) -> f64 {
        self.explained / self.poses.len().max(1) as f64
    }

    /// Why the robot cannot be said to have been localized, if so: it never was, or it was lost for most of the time since.
    pub fn failure(&self) -> Option<String> {
        let since = self.localized.first().map(|first| self.poses.iter().filter(|pose| pose.stamp >= first.stamp).count());
        if since.is_some_and(|since| 2 * self.localized.len() >= since) {
            return None;
        }
        let (percent, least) = (100.0 * self.explained(), 100.0 * Belief::LEAST_EXPLAINED);
        Some(if self.explained() < Belief::LEAST_EXPLAINED {
            format!(
                "the robot was not localized: the map explains {percent:.0} % of the beams where it fits best, and the map of the place would \
                 more than {least:.0} %. Is it the right map, and right in scale? If so, give --initial-pose, or a longer drive"
            )
        } else {
            "the robot was not localized: several places of the map look like what it saw. Give --initial-pose, or a longer drive"
                .into()
        })
    }

    /// What the user should know of the time after the robot had first been localized: that it was lost again, and whether it still is.
    pub fn lost(&self) -> Option<String> {
        let first = self.localized.first()?;
        let since = self.poses.iter().filter(|pose| pose.stamp >= first.stamp);
        let lost: Vec<Stamp> = since.map(|pose| pose.stamp).filter(|stamp| !self.covariances.contains_key(stamp)).collect();
        let from_start = lost.first()?.seconds_since(self.poses.first()?.stamp);
        let at_the_end = if lost.last() == self.poses.last().map(|pose| &pose.stamp) { ", and is so at the end" } else { "" };
        Some(format!(
            "the robot was not localized any more at {} scans, the first {from_start:.1} s after the start{at_the_end}",
            lost.len()
        ))
    }

    /// Why scans were not used, and how many; empty if all were.
    pub fn unused(&self) -> Vec<String> {
        self.unused.in_words(self.poses.len() + self.unused.count())
    }

    /// Particles, how many of them are effective, and beams.
    fn means(&self) -> (f64, f64, f64) {
        let scans = self.poses.len().max(1) as f64;
        (self.particles as f64 / scans, self.effective / scans, self.beams as f64 / scans)
    }

    fn times(&self) -> [f64; 3] {
        let mut sorted = self.elapsed.clone();
        sorted.sort_unstable();
        [0.5, 0.99, 1.0].map(|share| quantile::of_sorted(&sorted, share).map_or(0.0, microseconds))
    }

    fn seconds_to_find(&self) -> Option<f64> {
        self.localized.first().zip(self.poses.first()).map(|(found, first)| found.stamp.seconds_since(first.stamp))
    }

    /// The errors against the truth, in the map, while the robot was localized: nothing is aligned. `None` when there are none.
    pub fn errors(&self, matched: &[MatchedPose]) -> Option<TruthErrors> {
        let errors: Vec<_> = matched.iter().map(|matched| matched.truth.between(&matched.estimate)).collect();
        let covariance = |matched: &MatchedPose| self.covariances.get(&matched.stamp);
        let estimates = matched.iter().filter_map(|m| Some((&m.estimate, covariance(m)?, &m.truth)));
        Some(TruthErrors { poses: PoseErrors::of(&errors)?, consistency: Consistency::of(estimates) })
    }

    /// One JSON object.
    pub fn to_json(&self, errors: Option<&TruthErrors>, problems: &[String]) -> Value {
        let ([p50, p99, max], (particles, effective, beams)) = (self.times(), self.means());
        let consistency = errors.and_then(|errors| errors.consistency);
        json!({
            "scans": self.poses.len(),
            "passed_over": self.between,
            "outcome": if self.failure().is_none() { "localized" } else { "not_localized" },
            "localized": self.localized.len(),
            "localized_after_s": self.seconds_to_find(),
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

    /// A table for people.
    pub fn to_text(&self, errors: Option<&TruthErrors>, problems: &[String]) -> String {
        let ([p50, p99, max], (particles, effective, beams)) = (self.times(), self.means());
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.add_row(["scans", &self.poses.len().to_string()]);
        if self.between > 0 {
            table.add_row(["passed over", &format!("{}: the timer found newer ones", self.between)]);
        }
        for unused in self.unused() {
            table.add_row(["unused", &unused]);
        }
        let found = self.seconds_to_find().map_or("never".into(), |seconds| format!("after {seconds:.2} s"));
        table.add_row(["localized", &format!("{} scans, first {found}", self.localized.len())]);
        table.add_row(["explained", &format!("{:.0} % of the beams by the map", 100.0 * self.explained())]);
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
                    &format!("NEES {nees:.1} (right: 3); {percent:.1} % of the positions within three sigma"),
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
