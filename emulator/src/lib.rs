//! An STM32F446 that runs the release firmware unmodified.
