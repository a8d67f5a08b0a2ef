//! Learners from outside: training, export and calibration.

mod algorithms;
mod analytic;
mod calibrate;
mod codebook;
mod export;
mod learning;
mod resume;
