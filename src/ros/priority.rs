//! Who goes first when there are more programs than processors.
//!
//! Handing a pose over wakes the thread that sends it, and that thread may take the processor at once. At normal priority any busy
//! program can then have it for some milliseconds, with the answer all but out.

use rustix::process::getpriority_process;
use thread_priority::{
    Error, NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

const REAL_TIME: ThreadSchedulePolicy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
const NORMAL: ThreadSchedulePolicy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);

/// The `nice` value of such work.
const LEISURELY: i32 = 10;

/// Whether a thread goes before all programs of normal priority. To be so only while an answer is due within a time budget: nobody
/// else has to wait for longer than that.
pub(super) struct Urgency {
    /// The priority to return to; `None`: there is no other.
    usual: Option<ThreadPriority>,
    urgent: bool,
}

impl Urgency {
    /// For the thread that calls; urgent from now on, where that is permitted. (It takes `CAP_SYS_NICE`, or a limit on real-time
    /// priorities above zero.)
    pub(super) fn of_this_thread() -> Self {
        let usual = getpriority_process(None).ok().and_then(of_nice).filter(|_| assume(REAL_TIME, ThreadPriority::Min).is_ok());
        Self { usual, urgent: usual.is_some() }
    }

    pub(super) fn is_permitted(&self) -> bool {
        self.usual.is_some()
    }

    /// For the thread that this was made for.
    pub(super) fn set(&mut self, urgent: bool) {
        let Some(usual) = self.usual else { return };
        if self.urgent != urgent {
            self.urgent = urgent;
            // What was permitted once is not refused later.
            let _ = if urgent { assume(REAL_TIME, ThreadPriority::Min) } else { assume(NORMAL, usual) };
        }
    }
}

/// Does something as urgently as answers that are due. The threads that it starts stay so.
pub(super) fn urgently<T>(work: impl FnOnce() -> T) -> T {
    let mut urgency = Urgency::of_this_thread();
    let result = work();
    urgency.set(false);
    result
}

/// Lets the calling thread go after all others of its process, and of normal priority: for work that nobody waits for.
pub(super) fn give_way() {
    let _ = rustix::process::setpriority_process(None, LEISURELY); // on Linux of the thread; nobody is worse off without
}

fn assume(policy: ThreadSchedulePolicy, priority: ThreadPriority) -> Result<(), Error> {
    set_thread_priority_and_policy(thread_native_id(), priority, policy)
}

/// The normal priority that the kernel calls `nice`.
fn of_nice(nice: i32) -> Option<ThreadPriority> {
    let all = (0..=u8::MAX).map_while(|value| ThreadPriorityValue::try_from(value).ok()).map(ThreadPriority::Crossplatform);
    all.into_iter().find(|priority| priority.to_posix(NORMAL) == Ok(nice))
}

/// Lets the threads of rosrust go first that write what was published, where they are no more urgent than this one: woken on its
/// processor, they would wait for all that it goes on with, as long as the scheduler's slice of 3 ms.
pub(super) fn let_writers_go_first() {
    std::thread::yield_now();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nice_value_is_found_again() {
        for nice in -20..=19 {
            assert_eq!(of_nice(nice).unwrap().to_posix(NORMAL), Ok(nice));
        }
        assert_eq!(of_nice(20), None);
    }

    #[test]
    fn threads_begun_urgently_stay_urgent() {
        let policy = || thread_priority::thread_schedule_policy().unwrap();
        let begun = urgently(|| std::thread::spawn(policy)).join().unwrap();
        assert_eq!(policy(), NORMAL, "who began them is not");
        let is_permitted = Urgency::of_this_thread().is_permitted();
        assert_eq!(begun, if is_permitted { REAL_TIME } else { NORMAL });
    }

    #[test]
    fn what_was_urgent_returns_to_where_it_was() {
        let before = getpriority_process(None).unwrap();
        let mut urgency = Urgency::of_this_thread();
        urgency.set(false);
        assert_eq!(getpriority_process(None).unwrap(), before);
        assert_eq!(thread_priority::thread_schedule_policy(), Ok(NORMAL));
    }
}
