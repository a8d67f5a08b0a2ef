//! Parts of a file that a message quotes.

/// Characters of a file that a message quotes at most.
const EXCERPT_MAX: usize = 200;

/// Why a file whose lines end with a carriage return alone is refused, and what to do.
pub const CARRIAGE_RETURNS: &str = "its lines end with a carriage return alone: expected the line ends of Unix or \
                                    Windows; save the file again with these";

/// The beginning of a text of a file, of at most 200 characters: a message must not be as long as the file.
///
/// ```
/// use heliostat_files::excerpt;
///
/// assert_eq!(excerpt("time,user,x,y"), "time,user,x,y");
/// assert_eq!(excerpt(&"é".repeat(1000)), "é".repeat(200) + "...");
/// ```
pub fn excerpt(text: &str) -> String {
    match text.char_indices().nth(EXCERPT_MAX) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
