//! Reads an input as a list of choices: the same bytes always give the same choices.

/// Patterns that break readers: the ends of number types, varints that go on, NaN, infinity.
const PATTERNS: [&[u8]; 12] = [
    &[0],
    &[0xff],
    &[0x80, 0x00],
    &[0xff, 0xff, 0xff, 0xff, 0x0f],
    &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01],
    &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f],
    &[0, 0, 0xc0, 0x7f],
    &[0, 0, 0x80, 0x7f],
    &[1, 0, 0, 0],
    &[0xff, 0xff, 0x7f, 0x7f],
    &[0, 0, 0, 0, 0, 0, 0xf0, 0x7f],
    b"\x1b[31m\0",
];

/// Words that break readers of text files.
const WORDS: [&str; 20] = [
    "0",
    "-1",
    "-0.0",
    "1e9",
    "1e38",
    "1e308",
    "-1e308",
    "5e-324",
    "4294967296",
    "18446744073709551615",
    "99999999999999999999999",
    "nan",
    "inf",
    "-inf",
    "\"\"",
    "[]",
    "true",
    "\u{1b}[2J",
    "",
    "1.0000001",
];

/// The choices of one input; after its last byte every choice is 0.
#[derive(Clone, Debug)]
pub struct Script<'a> {
    rest: &'a [u8],
}

impl<'a> Script<'a> {
    pub fn new(input: &'a [u8]) -> Self {
        Self { rest: input }
    }

    pub fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.rest.split_first() else { return 0 };
        self.rest = rest;
        *first
    }

    /// A number below `count`, which is at most 256.
    pub fn below(&mut self, count: usize) -> usize {
        usize::from(self.byte()) % count
    }

    /// A position in a list of any length; 0 in an empty one.
    pub fn position(&mut self, length: usize) -> usize {
        let two = usize::from(self.byte()) << 8 | usize::from(self.byte());
        two % length.max(1)
    }

    pub fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == count - 1
    }

    pub fn word(&mut self) -> u64 {
        let mut bytes = [0; 8];
        let taken = self.take(8);
        bytes[..taken.len()].copy_from_slice(taken);
        u64::from_le_bytes(bytes)
    }

    /// The next bytes of the input, at most `count`.
    pub fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.rest.split_at(count.min(self.rest.len()));
        self.rest = rest;
        taken
    }

    /// Changes bytes of a file or payload: 1 to 4 edits.
    pub fn edit_bytes(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(4) {
            let at = self.position(bytes.len());
            let length = self.below(16).min(bytes.len() - at);
            match self.below(6) {
                0 if !bytes.is_empty() => bytes[at] ^= 1 << self.below(8),
                1 if !bytes.is_empty() => bytes[at] = self.byte(),
                2 => drop(bytes.drain(at..at + length)),
                3 => bytes.truncate(at),
                4 => {
                    let copy = bytes[at..at + length].to_vec();
                    bytes.splice(at..at, copy);
                }
                _ => {
                    let pattern = PATTERNS[self.below(PATTERNS.len())];
                    let end = (at + pattern.len()).min(bytes.len());
                    bytes.splice(at..end, pattern.iter().copied());
                }
            }
        }
    }

    /// Changes a text: exchanges numbers and other values, moves lines, and edits bytes.
    pub fn edit_text(&mut self, text: &str) -> String {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for _ in 0..=self.below(4) {
            let at = self.position(lines.len());
            match self.below(8) {
                0 => drop(lines.drain(at..lines.len().min(at + 1))),
                1 if !lines.is_empty() => lines.insert(at, lines[at].clone()),
                2 if !lines.is_empty() => {
                    let other = self.position(lines.len());
                    lines.swap(at, other);
                }
                3 => {
                    let mut bytes = lines.join("\n").into_bytes();
                    self.edit_bytes(&mut bytes);
                    lines = String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect();
                }
                _ if !lines.is_empty() => {
                    let word = WORDS[self.below(WORDS.len())];
                    let value = self.below(4);
                    lines[at] = with_value(&lines[at], value, word);
                }
                _ => {}
            }
        }
        lines.join("\n")
    }
}

/// The line with a word in place of its n-th value, counted from the first `=` if there is one.
fn with_value(line: &str, number: usize, word: &str) -> String {
    let start = line.find('=').map_or(0, |at| at + 1);
    let is_value = |letter: char| letter.is_alphanumeric() || matches!(letter, '.' | '-' | '+' | '_' | '"');
    let mut values: Vec<(usize, usize)> = Vec::new();
    for (at, letter) in line.char_indices().filter(|(at, letter)| *at >= start && is_value(*letter)) {
        match values.last_mut() {
            Some((_, end)) if *end == at => *end += letter.len_utf8(),
            _ => values.push((at, at + letter.len_utf8())),
        }
    }
    match values.get(number % values.len().max(1)) {
        Some(&(from, to)) => format!("{}{word}{}", &line[..from], &line[to..]),
        None => format!("{line}{word}"),
    }
}
