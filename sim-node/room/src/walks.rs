//! Recorded walks of pedestrian data sets, prepared for `users.trace`.
//!
//! 1. [`formats`] reads the [`rows`] of a published format.
//! 2. [`tracks`] sorts them by pedestrian, and ends a track at a gap or at the edge of a crop.
//! 3. [`selection`] chooses users who are present throughout, and their sample times.
//! 4. [`placement`] moves and scales the walks onto the floor of a room.
//! 5. [`text`] writes the CSV that [`crate::world::trace`] plays.
//!
//! [`figures`] describes what was read, [`plausibility`] what is unusual about it. No function opens a file.
//!
//! # Example
//! ```
//! use heliostat_room::walks::formats::{Source, WalkFormat, read};
//! use heliostat_room::walks::tracks::{Collector, Kept};
//!
//! let text = "time,user,x,y\n0,a,0,0\n0.5,a,1,0\n";
//! let mut collector = Collector::new(Kept::default());
//! read(&Source::of(WalkFormat::Csv), text.as_bytes(), &mut |row| collector.add(row))?;
//! assert_eq!(collector.finish().tracks[0].duration_s(), 0.5);
//! # Ok::<(), heliostat_room::walks::formats::ReadError>(())
//! ```

mod dialect;
pub mod figures;
pub mod formats;
pub mod placement;
pub mod plausibility;
pub mod rows;
pub mod selection;
pub mod text;
pub mod tracks;
