//! A Rust source file as the rules of ARCHITECTURE.md read it: names and paths, without comments,
//! strings and tests.
//!
//! This is a lexer and a reader of `use` trees, not a compiler. It sees every `use` and every path
//! that is written with `::`. It does not see methods (`value.name()`), names that a macro makes,
//! or which `cfg` is active; `#[cfg(test)]` items are left out.

use std::collections::BTreeSet;

/// What a source file names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RustSource {
    /// Every name that a `use` brings in.
    pub imports: Vec<Import>,
    /// Paths of two or more segments outside `use`, and macro calls as one segment such as
    /// `println!`.
    pub paths: Vec<Vec<String>>,
    /// Every other name in the code, methods and fields included.
    pub words: BTreeSet<String>,
    /// Names of the items that the file defines, methods included.
    pub definitions: BTreeSet<String>,
    /// Modules in files of their own that exist in tests only.
    pub test_modules: BTreeSet<String>,
}

/// One leaf of a `use` tree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Import {
    /// The path; its last segment is `*` for a glob.
    pub path: Vec<String>,
    /// The name under which the file knows it.
    pub name: String,
    /// Whether it is `pub`, `pub(crate)` and the like: a re-export.
    pub is_public: bool,
}

/// Keywords that come before the name of an item.
const ITEMS: [&str; 9] = ["struct", "enum", "union", "trait", "fn", "const", "static", "type", "mod"];

impl RustSource {
    /// Reads the text of a file.
    pub fn parse(text: &str) -> Self {
        let mut source = Self::default();
        let tokens = source.without_tests(tokens(text));
        let mut at = 0;
        while at < tokens.len() {
            at = match tokens[at].as_str() {
                "use" if tokens.get(at + 1).is_some_and(|next| next != "<") => source.take_use(&tokens, at),
                _ if is_name(&tokens[at]) => source.take_path(&tokens, at),
                _ => at + 1,
            };
        }
        source
    }

    /// Drops every item behind `#[cfg(test)]`.
    fn without_tests(&mut self, tokens: Vec<String>) -> Vec<String> {
        const TEST: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];
        let mut kept = Vec::with_capacity(tokens.len());
        let mut at = 0;
        while at < tokens.len() {
            if !tokens[at..].iter().zip(TEST).all(|(token, expected)| token == expected) || at + 7 > tokens.len() {
                kept.push(tokens[at].clone());
                at += 1;
                continue;
            }
            let end = end_of_item(&tokens, at + TEST.len());
            if let [.., keyword, name, semicolon] = &tokens[at..end]
                && keyword == "mod"
                && semicolon == ";"
            {
                self.test_modules.insert(name.clone());
            }
            at = end;
        }
        kept
    }

    /// Reads a `use` statement; returns where the next statement begins.
    fn take_use(&mut self, tokens: &[String], start: usize) -> usize {
        let length = tokens[start..].iter().position(|token| token == ";").unwrap_or(tokens.len() - start);
        let is_public = start > 0 && matches!(tokens[start - 1].as_str(), "pub" | ")");
        let mut leaves = Vec::new();
        use_tree(&tokens[start + 1..start + length], &[], &mut leaves);
        self.imports.extend(leaves.into_iter().map(|(path, name)| Import { path, name, is_public }));
        start + length
    }

    /// Reads a name or a path; returns the position after it.
    fn take_path(&mut self, tokens: &[String], start: usize) -> usize {
        let mut path = vec![tokens[start].clone()];
        let mut at = start + 1;
        while tokens.get(at).is_some_and(|token| token == "::") && tokens.get(at + 1).is_some_and(|next| is_name(next))
        {
            path.push(tokens[at + 1].clone());
            at += 2;
        }
        let before = start.checked_sub(1).map_or("", |before| tokens[before].as_str());
        if path.len() > 1 {
            self.words.insert(path[0].clone());
            self.paths.push(path);
        } else if tokens.get(at).is_some_and(|token| token == "!") && tokens.get(at + 1).is_some_and(|next| next != "=")
        {
            self.paths.push(vec![format!("{}!", path[0])]);
        } else if ITEMS.contains(&before) {
            self.definitions.insert(path.remove(0));
        } else {
            self.words.insert(path.remove(0));
        }
        at
    }
}

/// Where the item that begins here ends: after its `;` or after its closing brace.
fn end_of_item(tokens: &[String], start: usize) -> usize {
    let mut depth = 0_usize;
    for (index, token) in tokens.iter().enumerate().skip(start) {
        match token.as_str() {
            "{" | "(" | "[" => depth += 1,
            "}" | ")" | "]" => {
                depth = depth.saturating_sub(1);
                if depth == 0 && token == "}" {
                    return index + 1;
                }
            }
            ";" if depth == 0 => return index + 1,
            _ => {}
        }
    }
    tokens.len()
}

/// Collects the leaves of a `use` tree, each as its path and the name that it brings in.
fn use_tree(tokens: &[String], prefix: &[String], leaves: &mut Vec<(Vec<String>, String)>) {
    let mut path = prefix.to_vec();
    let mut renamed = None;
    let mut at = 0;
    while at < tokens.len() {
        match tokens[at].as_str() {
            "{" => {
                let end = at + end_of_item(&tokens[at..], 0);
                for part in split_at_commas(&tokens[at + 1..end.saturating_sub(1).max(at + 1)]) {
                    use_tree(part, &path, leaves);
                }
                return;
            }
            "as" => {
                renamed = tokens.get(at + 1).cloned();
                at += 1;
            }
            "::" => {}
            segment => path.push(segment.to_owned()),
        }
        at += 1;
    }
    if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    if let Some(last) = path.last().cloned() {
        leaves.push((path, renamed.unwrap_or(last)));
    }
}

/// The parts between the commas that stand outside braces.
fn split_at_commas(tokens: &[String]) -> Vec<&[String]> {
    let mut depth = 0_i32;
    let parts = tokens.split(|token| {
        depth += i32::from(token == "{") - i32::from(token == "}");
        depth == 0 && token == ","
    });
    parts.filter(|part| !part.is_empty()).collect()
}

fn is_name(token: &str) -> bool {
    token.starts_with(|first: char| first.is_alphabetic() || first == '_')
}

/// Names, numbers, `::` and single characters; no comments, strings, characters and lifetimes.
fn tokens(text: &str) -> Vec<String> {
    let text: Vec<char> = text.chars().collect();
    let mut tokens = Vec::new();
    let mut at = 0;
    while at < text.len() {
        let next = text.get(at + 1).copied().unwrap_or(' ');
        at = match (text[at], next) {
            ('/', '/') => position(&text, at, |rest| rest[0] == '\n'),
            ('/', '*') => end_of_comment(&text, at),
            ('"', _) => end_of_string(&text, at),
            ('\'', _) => end_of_quote(&text, at, next),
            (':', ':') => {
                tokens.push("::".to_owned());
                at + 2
            }
            (first, _) if first.is_alphanumeric() || first == '_' => {
                let end = position(&text, at, |rest| !(rest[0].is_alphanumeric() || rest[0] == '_'));
                let name: String = text[at..end].iter().collect();
                match end_of_raw_string(&text, &name, end) {
                    Some(end) => end,
                    None => {
                        tokens.push(name);
                        end
                    }
                }
            }
            (space, _) if space.is_whitespace() => at + 1,
            (other, _) => {
                tokens.push(other.to_string());
                at + 1
            }
        };
    }
    tokens
}

/// The first place from `start` on whose rest satisfies the condition, or the end.
fn position(text: &[char], start: usize, condition: impl Fn(&[char]) -> bool) -> usize {
    (start..text.len()).find(|at| condition(&text[*at..])).unwrap_or(text.len())
}

/// Behind a block comment, which may hold others.
fn end_of_comment(text: &[char], start: usize) -> usize {
    let mut depth = 0_usize;
    let mut at = start;
    while at < text.len() {
        match (text[at], text.get(at + 1)) {
            ('/', Some('*')) => (depth, at) = (depth + 1, at + 2),
            ('*', Some('/')) => (depth, at) = (depth - 1, at + 2),
            _ => at += 1,
        }
        if depth == 0 {
            return at;
        }
    }
    at
}

fn end_of_string(text: &[char], start: usize) -> usize {
    let mut at = start + 1;
    while at < text.len() && text[at] != '"' {
        at += if text[at] == '\\' { 2 } else { 1 };
    }
    at + 1
}

/// Behind a character, or behind the name of a lifetime.
fn end_of_quote(text: &[char], start: usize, next: char) -> usize {
    if next == '\\' {
        return position(text, start + 3, |rest| rest[0] == '\'') + 1;
    }
    if text.get(start + 2) == Some(&'\'') {
        return start + 3;
    }
    position(text, start + 1, |rest| !(rest[0].is_alphanumeric() || rest[0] == '_'))
}

/// Behind a raw string that begins with this prefix; nothing where the name is no such prefix.
fn end_of_raw_string(text: &[char], prefix: &str, start: usize) -> Option<usize> {
    if !matches!(prefix, "r" | "br" | "cr") {
        return None;
    }
    let quote = position(text, start, |rest| rest[0] != '#');
    if text.get(quote) != Some(&'"') {
        return None;
    }
    let hashes = quote - start;
    let ends = |rest: &[char]| rest[0] == '"' && rest[1..].iter().take_while(|next| **next == '#').count() >= hashes;
    Some(position(text, quote + 1, ends) + 1 + hashes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn imported(text: &str) -> Vec<(String, String)> {
        RustSource::parse(text).imports.into_iter().map(|import| (import.path.join("::"), import.name)).collect()
    }

    #[test]
    fn a_use_tree_yields_every_leaf_with_its_local_name() {
        let leaves = imported("use std::{fs, time::{self, Instant as Clock}}; pub(crate) use super::plan::*;");
        let expected =
            [("std::fs", "fs"), ("std::time", "time"), ("std::time::Instant", "Clock"), ("super::plan::*", "*")];
        assert_eq!(leaves, expected.map(|(path, name)| (path.to_owned(), name.to_owned())));
        let source = RustSource::parse("pub use a::B; use c::D;");
        assert_eq!(source.imports.iter().map(|import| import.is_public).collect::<Vec<_>>(), [true, false]);
    }

    #[test]
    fn paths_and_macros_outside_use_are_seen() {
        let source = RustSource::parse("fn f<'a>(x: &'a u8) { std::fs::read('\\'', '{'); println!(\"{x}\"); a != b }");
        assert_eq!(source.paths, [vec!["std", "fs", "read"], vec!["println!"]]);
        assert!(source.definitions.contains("f"));
        assert!(source.words.contains("b"));
    }

    #[test]
    fn comments_strings_and_tests_are_not_seen() {
        let text = r##"
            // std::fs::read
            /* outer /* std::net::X */ std::net::Y */
            const TEXT: &str = "std::thread::spawn // \" std::env";
            const RAW: &str = r#"std::process::exit " "#;
            #[cfg(test)]
            #[allow(unused)]
            mod tests { use std::time::Instant; fn x() { if true { std::fs::read(); } } }
            #[cfg(test)]
            mod fixtures;
            fn after() { real::path(); }
        "##;
        let source = RustSource::parse(text);
        assert_eq!(source.paths, [vec!["real", "path"]]);
        assert!(source.imports.is_empty(), "{source:?}");
        assert!(source.test_modules.contains("fixtures"));
    }
}
