//! Time that the machine takes away: a program of higher priority, an interrupt, the host of a virtual machine. It may take it from any
//! step of any answer, so that no step's own costs tell how often an answer is late for it.
//!
//! Work that goes on up to a reserve `R` before its deadline is late by a preemption of length `L > R` that begins within the `L - R`
//! before the end of the work. The share of such places is the sum of `max(L - R, 0)` over all preemptions by the time worked; the
//! reserve is the least for which it is no more than the share of answers that may be late.

use std::time::Duration;

/// What a step takes beyond the usual is no preemption below this: steps vary.
const SHORTEST: Duration = Duration::from_micros(5);
/// Preemptions that are remembered, the latest.
const WINDOW: usize = 2048;

/// The latest preemptions.
#[derive(Clone, Debug)]
pub(super) struct Preemptions {
    /// Share of the answers that may be late.
    may_be_late: f64,
    /// When each began, by the time worked until then, and its length; from `next` on the oldest, once there are [`WINDOW`].
    latest: Vec<(Duration, Duration)>,
    next: usize,
    worked: Duration,
    is_learned: bool,
    reserve: Duration,
    scratch: Vec<Duration>,
}

impl Preemptions {
    /// Knows of none yet.
    pub(super) fn new(may_be_late: f64) -> Self {
        Self {
            may_be_late,
            latest: Vec::with_capacity(WINDOW),
            next: 0,
            worked: Duration::ZERO,
            is_learned: true,
            reserve: Duration::ZERO,
            scratch: Vec::with_capacity(WINDOW),
        }
    }

    /// Takes note of a step that usually takes `usual`.
    pub(super) fn observe(&mut self, usual: Duration, cost: Duration) {
        let preemption = cost.saturating_sub(usual);
        if preemption >= SHORTEST {
            self.push((self.worked, preemption));
        }
        self.worked += cost.min(usual);
    }

    fn push(&mut self, preemption: (Duration, Duration)) {
        if self.latest.len() < WINDOW {
            self.latest.push(preemption);
        } else {
            self.latest[self.next] = preemption;
            self.next = (self.next + 1) % WINDOW;
        }
        self.is_learned = false;
    }

    /// Draws conclusions.
    pub(super) fn learn(&mut self) {
        if std::mem::replace(&mut self.is_learned, true) {
            return;
        }
        let since = if self.latest.len() < WINDOW { Duration::ZERO } else { self.latest[self.next].0 };
        let may_be_lost = self.worked.saturating_sub(since).mul_f64(self.may_be_late);
        self.scratch.clear();
        self.scratch.extend(self.latest.iter().map(|&(_, length)| length));
        self.scratch.sort_unstable_by(|a, b| b.cmp(a));
        self.reserve = reserve(&self.scratch, may_be_lost);
    }

    /// Time to keep back.
    pub(super) fn reserve(&self) -> Duration {
        self.reserve
    }
}

/// The least `R` for which `max(L - R, 0)`, summed over all lengths `L`, the longest first, is `may_be_lost` at most: the sum is convex
/// in `R`, and greater than each of the lines that it is made of.
fn reserve(lengths: &[Duration], may_be_lost: Duration) -> Duration {
    let mut sum = Duration::ZERO;
    let reserve_for = |(count, length): (u32, &Duration)| {
        sum += *length;
        sum.saturating_sub(may_be_lost) / count
    };
    (1..).zip(lengths).map(reserve_for).max().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(time: u64) -> Duration {
        Duration::from_micros(time)
    }

    #[test]
    fn a_reserve_leaves_as_much_uncovered_as_may_be_lost() {
        let lengths = [us(100), us(50), us(40), us(10)];
        for may_be_lost in [0, 10, 60, 120, 199] {
            let reserve = reserve(&lengths, us(may_be_lost));
            let uncovered: Duration = lengths.iter().map(|length| length.saturating_sub(reserve)).sum();
            assert!(
                uncovered.abs_diff(us(may_be_lost)) < Duration::from_nanos(10),
                "{may_be_lost}: {reserve:?} leaves {uncovered:?}"
            );
        }
        assert_eq!(reserve(&lengths, us(200)), Duration::ZERO);
        assert_eq!(reserve(&[], us(1)), Duration::ZERO);
    }

    #[test]
    fn as_many_answers_are_late_as_may_be() {
        let mut preemptions = Preemptions::new(0.01);
        // Steps of 10 us; every fiftieth is preempted for 20 us, every five hundredth for 80.
        let cost = |i: u64| {
            us(10
                + if i % 500 == 7 {
                    80
                } else if i % 50 == 7 {
                    20
                } else {
                    0
                })
        };
        (0..10_000).for_each(|i| preemptions.observe(us(10), cost(i)));
        preemptions.learn();
        // In 5000 us of work there is one of 80, of which 50 may be lost.
        assert!(preemptions.reserve().abs_diff(us(30)) < us(1), "{:?}", preemptions.reserve());
    }

    #[test]
    fn steps_vary_and_what_is_long_ago_is_forgotten() {
        let mut preemptions = Preemptions::new(0.001);
        (0..10_000).for_each(|_| preemptions.observe(us(10), us(14)));
        preemptions.learn();
        assert_eq!(preemptions.reserve(), Duration::ZERO);
        let mut reserve_after = |length: u64| {
            for _ in 0..WINDOW {
                preemptions.observe(us(10), us(10 + length));
                (0..100).for_each(|_| preemptions.observe(us(10), us(10)));
            }
            preemptions.learn();
            preemptions.reserve()
        };
        let (long, short) = (reserve_after(500), reserve_after(20));
        assert!(long > us(490) && short > us(10) && short < us(20), "{long:?} {short:?}");
    }
}
