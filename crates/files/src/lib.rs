//! Files that a flag, a scenario or a configuration names.
//!
//! [`open_file`], [`read_bytes`] and [`read_text`] read them: a pipe without a writer must not hang a program, and a
//! device must not fill its memory. [`foreign_file`] and [`foreign_text`] say what a file is instead, and [`excerpt`]
//! bounds what a message quotes. [`write_advice`] says what to do about a file that cannot be written, and [`shell_word`]
//! writes its path into a command. [`UnusableInput`] marks the errors that such a file, or another input of a user,
//! causes. With the feature `write`, `write_whole` writes a file that is complete at any time.
//! With the feature `toml`, `from_toml` reads a text of TOML, and says where and why it is refused.

mod bounded_file;
mod excerpt;
mod foreign_file;
mod shell_word;
#[cfg(feature = "toml")]
pub mod similar;
#[cfg(feature = "toml")]
pub mod toml_text;
mod unusable_input;
#[cfg(feature = "write")]
mod whole_file;
mod write_advice;

pub use bounded_file::{open_file, read_bytes, read_text};
pub use excerpt::{CARRIAGE_RETURNS, excerpt};
pub use foreign_file::{foreign_file, foreign_text};
pub use shell_word::shell_word;
#[cfg(feature = "toml")]
pub use toml_text::{TomlError, from_toml};
pub use unusable_input::UnusableInput;
#[cfg(feature = "write")]
pub use whole_file::{folder_of, is_direct, write_whole};
pub use write_advice::write_advice;
