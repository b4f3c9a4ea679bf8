//! Nothing but its manifest: features of third-party libraries, alike in all builds.
