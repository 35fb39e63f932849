//! Shared memory between the node and a controller on the same machine: call for the answer now, and learn of each estimate.
//!
//! The node has a [`Responder`], the controller a [`Client`], or the functions of the header
//! `include/anytime_scan_matcher/shared_memory.h`; what lies where is in [`layout`].
//!
//! ```
//! use std::time::Duration;
//!
//! use anytime_scan_matcher::geometry::Pose2;
//! use anytime_scan_matcher::shared_memory::{Client, Responder, SharedEstimate};
//!
//! # let name = &format!("/anytime_scan_matcher_doctest_{}", std::process::id());
//! let responder = Responder::create(name)?;
//! let client = Client::open(name)?;
//!
//! // Nothing is being worked on: the answer is the newest estimate, and there is none yet.
//! let request = client.request();
//! assert_eq!(client.wait_for_answer(request, Duration::from_secs(1))?, None);
//!
//! responder.begin(); // a scan is taken up
//! let request = client.request();
//! assert!(responder.is_requested()); // what the refinement asks after each iteration
//! let odom_from_base = Pose2::new(1.0, 2.0, 0.5);
//! responder.publish(&SharedEstimate { odom_from_base, ok: true, interrupted: true, ..SharedEstimate::default() });
//!
//! let answer = client.wait_for_answer(request, Duration::from_secs(1))?.ok_or("there is an estimate")?;
//! assert_eq!((answer.number, answer.estimate.odom_from_base), (1, odom_from_base));
//! assert_eq!(client.wait_for_completion(0, Duration::from_secs(1))?, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # The protocol
//!
//! All words are counts, none is ever set back: an edge is the difference of two counts, so that none is lost by looking late, and
//! none seen twice. Every side stores to its own words only.
//!
//! | who | does | memory order |
//! |---|---|---|
//! | controller | adds 1 to `requested`: the sum is the request's number; wakes `requested` if `idle` is set | sequentially consistent |
//! | node, between iterations | looks whether `requested` is beyond `acknowledged` | acquire |
//! | node, with an estimate | writes it (sequence lock), adds 1 to `completed` | release |
//! | node, at work or idle from now on | stores `idle`, then loads `requested` | sequentially consistent |
//! | ... | stores that as `acknowledged`, wakes `acknowledged`, and `completed` after an estimate | release |
//! | node, woken while idle | stores `requested` as `acknowledged`, wakes it | release |
//! | controller | waits for `acknowledged` to reach its number, then reads the newest estimate | acquire |
//! | controller | waits for `completed` to change, counts the edges by the difference | acquire |
//!
//! A waiter looks at memory for [`SPIN`], then sleeps on the word's futex. The node's death ends a wait after [`PEER_CHECK`] at the
//! latest; its life is an exclusive `flock` on the segment, which the kernel releases whatever way a process dies, and which, unlike
//! a process id, nobody else can come to hold by chance. A controller may die at any moment: its request is answered to nobody.
//!
//! Whoever may open the segment can break it: it is made for the node's own user only.

mod client;
mod error;
mod estimate;
mod futex;
pub mod layout;
mod mapping;
mod name;
mod responder;
mod server;

pub use client::{Client, Counts, PEER_CHECK, RequestNumber, SPIN};
pub use error::{Problem, SharedMemoryError};
pub use estimate::{CompletedEstimate, SharedEstimate};
pub use responder::Responder;

/// Name of the segment unless another one is given.
pub const DEFAULT_NAME: &str = "/anytime_scan_matcher";
