//! Figures as pictures: interactive in a page, and as SVG files.

pub mod interactive;
pub mod style;
pub mod svg;
