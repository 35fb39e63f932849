//! Thread priorities, for machines with more busy programs than processors.
//!
//! Publishing a pose wakes the thread that writes it to the socket, and that thread may preempt this one at once. At normal
//! priority any busy program can then take the processor for some milliseconds just before the answer is sent.

use rustix::process::getpriority_process;
use thread_priority::{
    Error, NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

const REAL_TIME: ThreadSchedulePolicy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
const NORMAL: ThreadSchedulePolicy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);

/// The `nice` value of background work.
const BACKGROUND_NICE: i32 = 10;

/// Switches a thread between real-time and normal priority. Use real-time priority only while an answer is due within a time
/// budget, so that no other program has to wait longer than that.
pub(super) struct RealTimePriority {
    /// The normal priority to return to; `None`: real-time priority is not permitted.
    normal: Option<ThreadPriority>,
    is_on: bool,
}

impl RealTimePriority {
    /// Gives the calling thread real-time priority, if that is permitted. (It requires `CAP_SYS_NICE`, or a limit on real-time
    /// priorities above zero.)
    pub(super) fn of_this_thread() -> Self {
        let normal = getpriority_process(None)
            .ok()
            .and_then(priority_of_nice)
            .filter(|_| set_priority(REAL_TIME, ThreadPriority::Min).is_ok());
        Self { normal, is_on: normal.is_some() }
    }

    pub(super) fn is_permitted(&self) -> bool {
        self.normal.is_some()
    }

    /// Switches real-time priority on or off. To be called by the thread that this was made for.
    pub(super) fn set(&mut self, is_on: bool) {
        let Some(normal) = self.normal else { return };
        if self.is_on != is_on {
            self.is_on = is_on;
            // Cannot fail: it was permitted before.
            let _ = if is_on { set_priority(REAL_TIME, ThreadPriority::Min) } else { set_priority(NORMAL, normal) };
        }
    }
}

/// Runs `work` with real-time priority. Threads that it starts keep that priority.
pub(super) fn with_real_time_priority<T>(work: impl FnOnce() -> T) -> T {
    let mut priority = RealTimePriority::of_this_thread();
    let result = work();
    priority.set(false);
    result
}

/// Lowers the priority of the calling thread below normal: for background work.
pub(super) fn lower_priority() {
    let _ = rustix::process::setpriority_process(None, BACKGROUND_NICE); // affects only the thread on Linux; failure is harmless
}

fn set_priority(policy: ThreadSchedulePolicy, priority: ThreadPriority) -> Result<(), Error> {
    set_thread_priority_and_policy(thread_native_id(), priority, policy)
}

/// The normal priority that corresponds to a `nice` value.
fn priority_of_nice(nice: i32) -> Option<ThreadPriority> {
    let all = (0..=u8::MAX).map_while(|value| ThreadPriorityValue::try_from(value).ok()).map(ThreadPriority::Crossplatform);
    all.into_iter().find(|priority| priority.to_posix(NORMAL) == Ok(nice))
}

/// Yields to the threads of rosrust that write published messages to the sockets, if they have the same priority as this thread.
/// If they were woken on this thread's processor, they would otherwise wait while it continues, for as long as the scheduler's
/// slice of 3 ms.
pub(super) fn yield_to_writers() {
    std::thread::yield_now();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nice_value_is_converted_back_to_itself() {
        for nice in -20..=19 {
            assert_eq!(priority_of_nice(nice).unwrap().to_posix(NORMAL), Ok(nice));
        }
        assert_eq!(priority_of_nice(20), None);
    }

    #[test]
    fn threads_started_with_real_time_priority_keep_it() {
        let policy = || thread_priority::thread_schedule_policy().unwrap();
        let started = with_real_time_priority(|| std::thread::spawn(policy)).join().unwrap();
        assert_eq!(policy(), NORMAL, "the starting thread is back at normal priority");
        let is_permitted = RealTimePriority::of_this_thread().is_permitted();
        assert_eq!(started, if is_permitted { REAL_TIME } else { NORMAL });
    }

    #[test]
    fn real_time_priority_is_switched_back_to_the_normal_one() {
        let before = getpriority_process(None).unwrap();
        let mut priority = RealTimePriority::of_this_thread();
        priority.set(false);
        assert_eq!(getpriority_process(None).unwrap(), before);
        assert_eq!(thread_priority::thread_schedule_policy(), Ok(NORMAL));
    }
}
