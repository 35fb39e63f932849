//! Preemption: time that the machine takes away, by a program of higher priority, an interrupt, or the host of a virtual machine.
//! It can hit any step of any answer, so the costs of a single step do not show how often an answer is late because of it.
//!
//! Work that ends a reserve `R` before its deadline is late if a preemption of length `L > R` begins in the last `L - R` of the
//! work. The probability of that is the sum of `max(L - R, 0)` over all preemptions, divided by the time worked. The reserve is
//! the smallest `R` for which it does not exceed the allowed fraction of late answers.

use std::time::Duration;

/// A step that exceeds its typical time by less than this has not been preempted: step times vary.
const MIN_PREEMPTION: Duration = Duration::from_micros(5);
/// Number of latest preemptions kept.
const WINDOW: usize = 2048;

/// The latest preemptions.
#[derive(Clone, Debug)]
pub(super) struct Preemptions {
    /// Fraction of the answers that may be late.
    late_fraction: f64,
    /// Time worked before each preemption, and its length; a ring buffer that starts at `next` once it has [`WINDOW`] entries.
    latest: Vec<(Duration, Duration)>,
    next: usize,
    worked: Duration,
    is_up_to_date: bool,
    reserve: Duration,
    scratch: Vec<Duration>,
}

impl Preemptions {
    /// No preemptions yet.
    pub(super) fn new(late_fraction: f64) -> Self {
        Self {
            late_fraction,
            latest: Vec::with_capacity(WINDOW),
            next: 0,
            worked: Duration::ZERO,
            is_up_to_date: true,
            reserve: Duration::ZERO,
            scratch: Vec::with_capacity(WINDOW),
        }
    }

    /// Records a step that typically takes `typical`.
    pub(super) fn observe(&mut self, typical: Duration, cost: Duration) {
        let preemption = cost.saturating_sub(typical);
        if preemption >= MIN_PREEMPTION {
            self.push((self.worked, preemption));
        }
        self.worked += cost.min(typical);
    }

    fn push(&mut self, preemption: (Duration, Duration)) {
        if self.latest.len() < WINDOW {
            self.latest.push(preemption);
        } else {
            self.latest[self.next] = preemption;
            self.next = (self.next + 1) % WINDOW;
        }
        self.is_up_to_date = false;
    }

    /// Updates the reserve.
    pub(super) fn learn(&mut self) {
        if std::mem::replace(&mut self.is_up_to_date, true) {
            return;
        }
        let since = if self.latest.len() < WINDOW { Duration::ZERO } else { self.latest[self.next].0 };
        let allowed_loss = self.worked.saturating_sub(since).mul_f64(self.late_fraction);
        self.scratch.clear();
        self.scratch.extend(self.latest.iter().map(|&(_, length)| length));
        self.scratch.sort_unstable_by(|a, b| b.cmp(a));
        self.reserve = reserve(&self.scratch, allowed_loss);
    }

    /// Time to reserve.
    pub(super) fn reserve(&self) -> Duration {
        self.reserve
    }
}

/// The smallest `R` for which `max(L - R, 0)`, summed over all lengths `L` in descending order, is at most `allowed_loss`. The
/// sum is convex in `R`: it is the maximum of the lines that it consists of.
fn reserve(lengths: &[Duration], allowed_loss: Duration) -> Duration {
    let mut sum = Duration::ZERO;
    let reserve_for = |(count, length): (u32, &Duration)| {
        sum += *length;
        sum.saturating_sub(allowed_loss) / count
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
    fn the_reserve_leaves_exactly_the_allowed_loss_uncovered() {
        let lengths = [us(100), us(50), us(40), us(10)];
        for allowed_loss in [0, 10, 60, 120, 199] {
            let reserve = reserve(&lengths, us(allowed_loss));
            let uncovered: Duration = lengths.iter().map(|length| length.saturating_sub(reserve)).sum();
            assert!(
                uncovered.abs_diff(us(allowed_loss)) < Duration::from_nanos(10),
                "{allowed_loss}: {reserve:?} leaves {uncovered:?}"
            );
        }
        assert_eq!(reserve(&lengths, us(200)), Duration::ZERO);
        assert_eq!(reserve(&[], us(1)), Duration::ZERO);
    }

    #[test]
    fn the_allowed_fraction_of_answers_is_late() {
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
        // In 5000 us of work there is one preemption of 80 us, of which 50 may be lost.
        assert!(preemptions.reserve().abs_diff(us(30)) < us(1), "{:?}", preemptions.reserve());
    }

    #[test]
    fn step_variation_is_ignored_and_old_preemptions_are_forgotten() {
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
