//! Commands of `heliostat-lab`: here they name the command that does the work.

use crate::programs::LAB;

/// A command of earlier versions, and the command of the laboratory.
const MOVED: [(&[&str], &str); 14] = [
    (&["train"], "train"),
    (&["eval"], "eval"),
    (&["reproduce"], "reproduce"),
    (&["results"], "report"),
    (&["map"], "map"),
    (&["trace"], "trace"),
    (&["bench", "env"], "bench env"),
    (&["bench", "oracle"], "bench oracle"),
    (&["bench", "belief"], "bench belief"),
    (&["bench", "mirrors"], "bench mirrors"),
    (&["bench", "users"], "bench users"),
    (&["bench", "rooms"], "bench rooms"),
    (&["bench", "policies"], "bench policies"),
    (&["bench", "demo"], "bench demo"),
];

/// What to run instead, if the arguments begin with a command of the laboratory.
pub fn advice(arguments: &[String]) -> Option<String> {
    let (old, new) = MOVED.iter().find(|(old, _)| {
        arguments.len() >= old.len() && arguments.iter().zip(*old).all(|(argument, word)| argument == word)
    })?;
    let rest = arguments[old.len()..].iter().map(String::as_str);
    let words = std::iter::once(*new).chain(rest).collect::<Vec<_>>().join(" ");
    Some(format!(
        "{} belongs to the laboratory: run `{LAB} {words}`, or from the sources `cargo run --release -p {LAB} -- {words}`",
        old.join(" ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn advice_for(line: &str) -> Option<String> {
        advice(&line.split(' ').map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn the_advice_keeps_the_arguments_and_names_both_ways_to_run_it() {
        let advice = advice_for("bench env --seconds 1").expect("it has moved");
        for part in ["`heliostat-lab bench env --seconds 1`", "cargo run --release -p heliostat-lab -- bench env"] {
            assert!(advice.contains(part), "{advice}");
        }
        assert!(advice_for("results latency").is_some_and(|advice| advice.contains("`heliostat-lab report latency`")));
    }

    #[test]
    fn commands_of_this_program_have_no_advice() {
        for line in ["demo", "bench decide", "bench", "link --user 1,1 train"] {
            assert_eq!(advice_for(line), None, "{line}");
        }
    }
}
