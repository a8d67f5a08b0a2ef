//! Known names that resemble an unknown one, for messages about a misspelt name.

/// The known name nearest to an unknown one; `None` where none resembles it.
///
/// A name resembles another if at most a third of the letters of the longer one, or two, are inserted,
/// left out, replaced or exchanged with the next one, and at most half of them. Capitals and the signs `-` and `_` do
/// not count.
pub fn similar<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let plain = |name: &str| name.to_lowercase().replace('_', "-");
    let name = plain(name);
    let distances = known.into_iter().map(|known| (strsim::osa_distance(&name, &plain(known)), known));
    let (edits, nearest) = distances.min_by_key(|(edits, _)| *edits)?;
    let longer = name.len().max(nearest.len());
    (edits <= 2.max(longer / 3) && edits <= longer / 2 && edits < name.len()).then_some(nearest)
}

/// The end of a message about an unknown name: the similar one, or nothing.
pub fn hint<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    similar(name, known).map(|similar| format!("; a similar name exists: {similar}")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_name_resembles_the_nearest_known_one_and_another_word_none() {
        let known = ["hall", "atrium", "fixed-point", "specular", "pso"];
        for (name, expected) in [
            ("hal", Some("hall")),
            ("Fixed_Point", Some("fixed-point")),
            ("fixpoint", Some("fixed-point")),
            ("speculr", Some("specular")),
            ("pos", Some("pso")),
            ("foo", None),
            ("kitchen", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(similar(name, known), expected, "{name}");
        }
        assert_eq!(hint("atrim", known), "; a similar name exists: atrium");
    }
}
