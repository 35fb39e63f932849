//! Why a refinement stopped.

crate::choices! {
    /// Why a refinement stopped.
    pub enum StopReason {
        /// The last step was below epsilon.
        Converged = "converged",
        /// The correspondences are the same as in an earlier iteration: the steps repeat in a cycle.
        Cycle = "cycle",
        /// The limit `max_iterations` is reached.
        IterationLimit = "iteration_limit",
        /// The time budget is used up.
        Budget = "budget",
        /// The estimated error is within the requested bound.
        ErrorBound = "error_bound",
        /// The caller asked for the answer now.
        Interrupted = "interrupted",
        /// Too few sensed points have a correspondence.
        TooFewCorrespondences = "too_few_correspondences",
        /// The correspondences determine no finite pose.
        Singular = "singular",
    }
}

impl StopReason {
    /// Whether the match failed, so that its pose is unusable.
    pub fn is_failure(self) -> bool {
        matches!(self, Self::TooFewCorrespondences | Self::Singular)
    }
}
