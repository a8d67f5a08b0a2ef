//! Numbers with their noun: "1 user", "5 users".

/// A count with its noun, which takes an s in the plural.
///
/// ```
/// use heliostat_service::counted::counted;
///
/// assert_eq!([0, 1, 2].map(|count| counted(count, "user")), ["0 users", "1 user", "2 users"]);
/// ```
pub fn counted(count: usize, noun: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{ending}")
}
