//! The group file: which robots move as one body, and where each stands in it.
