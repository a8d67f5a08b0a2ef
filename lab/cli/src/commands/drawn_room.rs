//! What pictures of a room have in common.

use anyhow::Result;
use heliostat_channel::ChannelModel;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

/// A plan of a room, in m.
pub type Plan<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Draws LEDs as triangles of this colour, and mirror arrays as blue bars.
///
/// # Errors
/// An error of the drawing library.
pub fn draw_equipment(plan: &mut Plan, model: &ChannelModel, led: &RGBColor) -> Result<()> {
    plan.draw_series(
        model
            .leds
            .iter()
            .map(|one| TriangleMarker::new((one.position.x, one.position.y), 6, ShapeStyle::from(led).stroke_width(2))),
    )?;
    plan.draw_series(model.mirrors.arrays().iter().map(|array| {
        let ends = [0, array.columns() - 1].map(|column| array.positions()[column]);
        PathElement::new(ends.map(|at| (at.x, at.y)), BLUE.stroke_width(8))
    }))?;
    Ok(())
}
