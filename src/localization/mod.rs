//! A particle filter.
