//! Figures as SVG files.

pub mod style;
pub mod svg;
