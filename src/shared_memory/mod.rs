//! Shared memory between the node and a controller on the same machine. The controller can request an answer now, and wait for
//! each estimate.
//!
//! The node has a [`Responder`]; the controller uses a [`Client`], or the functions of the header
//! `include/anytime_scan_matcher/shared_memory.h`. The layout of the segment is in [`layout`].
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
//! // The node is idle: the answer is the newest estimate, but there is none yet.
//! let request = client.request();
//! assert_eq!(client.wait_for_answer(request, Duration::from_secs(1))?, None);
//!
//! responder.begin(); // the node begins to process a scan
//! let request = client.request();
//! assert!(responder.is_requested()); // checked by the refinement after each iteration
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
//! All requests, answers and estimates are counted, and no count is ever reset. Events are detected as the difference of two
//! counts, so that none is missed by checking late, and none is seen twice. Each side only writes its own words.
//!
//! | who | does | memory order |
//! |---|---|---|
//! | controller | adds 1 to `requested`: the sum is the request's number; wakes `requested` if `idle` is set | sequentially consistent |
//! | node, between iterations | checks whether `requested` is ahead of `acknowledged` | acquire |
//! | node, with an estimate | writes it (sequence lock), adds 1 to `completed` | release |
//! | node, when it becomes busy or idle | stores `idle`, then loads `requested` | sequentially consistent |
//! | ... | stores that as `acknowledged`, wakes `acknowledged`, and `completed` after an estimate | release |
//! | node, woken while idle | stores `requested` as `acknowledged`, wakes it | release |
//! | controller | waits for `acknowledged` to reach its number, then reads the newest estimate | acquire |
//! | controller | waits for `completed` to change, counts the new estimates by the difference | acquire |
//!
//! A waiter polls the memory for [`SPIN`], then sleeps on the word's futex. If the node dies, the wait ends after at most
//! [`PEER_CHECK`]: a living node holds an exclusive `flock` on the segment, which the kernel releases however the process dies.
//! Unlike a process id, no other process can come to hold the lock by accident. A controller may die at any moment; the answer to
//! its request is then ignored.
//!
//! Every process that can open the segment could corrupt it, so only the node's own user can open it.

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

/// Default name of the segment.
pub const DEFAULT_NAME: &str = "/anytime_scan_matcher";
