//! Functions in Python beside the built-in policies.

use heliostat_needs::needs;

use super::{SMALL, eval, mean, refusal, report};

#[needs("numpy")]
#[test]
fn a_function_in_python_is_compared_with_the_built_in_policies_state_by_state() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("mine.py");
    std::fs::write(
        &file,
        "import os\nimport sys\nimport numpy as np\n\
         print('a line of the module')\n\
         def flat(seen):\n    print('a line of the function')\n    return np.zeros(12)\n\
         def weights(seen):\n    return [0.0] * 10\n\
         weights.action = 'weights'\n\
         calls = 0\n\
         def fails(seen):\n    raise ValueError('no idea')\n\
         def exits(seen):\n    sys.exit(4)\n\
         def dies(seen):\n    os._exit(4)\n\
         def nan(seen):\n    return np.full(12, np.nan)\n\
         def short(seen):\n    return np.zeros(3)\n\
         def none(seen):\n    pass\n\
         def odd(seen):\n    return np.zeros(12)\n\
         odd.action = 'torque'\n",
    )
    .expect("writable");
    let name = |function: &str| format!("{}:{function}", file.to_str().expect("a plain path"));
    let (flat, weights) = (name("flat"), name("weights"));
    for mode in [&["--episodes", "3"][..], &["--closed-loop", "--episodes", "1"]] {
        let policies = format!("flat,{flat},{weights}");
        let flags = [&["--policies", policies.as_str(), "--seeds", "2"], mode, &SMALL].concat();
        let compared = report(&flags);
        let rate = |policy: &str| mean(&compared, policy, "sum_rate_mbps");
        assert_eq!(rate(&flat), rate("flat"), "the same angles give the same rates: {mode:?}");
        assert_eq!(compared["policies"][&flat]["difference_mbps"]["ci95"], 0.0, "paired");
        assert!(rate(&weights) > rate("flat"), "weights aim the mirrors: {mode:?}");
    }
    for (function, part) in [
        ("fails", "ValueError: no idea"),
        ("fails", "in fails"),
        ("exits", "SystemExit: 4"),
        ("exits", "in exits"),
        ("dies", "its process has ended: exit status: 4"),
        ("none", "none returned None: expected an action"),
        ("nan", "finite"),
        ("short", "length 3"),
        ("odd", "expected \"angles\" or \"weights\""),
        ("nothing", "mine.py has no function nothing"),
    ] {
        for mode in [&[][..], &["--closed-loop"]] {
            let message =
                refusal(&[&["--policies", &name(function), "--states", "20", "--seeds", "1"], mode, &SMALL].concat());
            assert!(message.contains(part), "{function}: {message}");
            assert!(!message.contains("<string>"), "lines of the program that calls {function}: {message}");
            let has_lines = matches!(function, "fails" | "exits");
            assert_eq!(message.contains("Traceback"), has_lines, "{function}: {message}");
        }
    }
    let other = folder.path().join("other.py");
    std::fs::write(&other, "import no_such_module\n").expect("writable");
    let message = refusal(&["--policies", &format!("{}:act", other.to_str().expect("a plain path"))]);
    for part in ["No module named 'no_such_module'; the interpreter is ", "or name another one in HELIOSTAT_PYTHON"] {
        assert!(message.contains(part), "{message}");
    }
    assert!(message.contains("other.py\", line 1") && !message.contains("<string>"), "{message}");
    std::fs::write(&other, "def act(seen)\n").expect("writable");
    let message = refusal(&["--policies", &format!("{}:act", other.to_str().expect("a plain path"))]);
    assert!(message.contains("def act(seen)") && !message.contains("<frozen"), "the line: {message}");
    let message = refusal(&["--policies", "nowhere.py:act"]);
    assert!(message.contains("no file nowhere.py"), "{message}");
    for unusable in ["nowhere.py:act", &name("nothing"), &name("odd")] {
        let output = eval(&[&["--policies", unusable, "--states", "20", "--seeds", "1"][..], &SMALL].concat());
        assert_eq!(output.status.code(), Some(2), "{unusable}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[needs("numpy")]
#[test]
fn a_function_begins_each_episode_and_each_state_without_what_it_has_seen() {
    let folder = tempfile::tempdir().expect("a folder");
    let [file, log] = ["mine.py", "calls"].map(|name| folder.path().join(name));
    let name = format!("{}:act", file.to_str().expect("a plain path"));
    std::fs::write(
        &file,
        "import pathlib\nimport numpy as np\n\
         def note(letter):\n    with open(pathlib.Path(__file__).parent / 'calls', 'a') as log:\n        log.write(letter)\n\
         def act(seen):\n    note('c')\n    return np.zeros(12)\n\
         act.reset = lambda: note('r')\n",
    )
    .expect("writable");
    let calls = |mode: &[&str]| {
        report(&[&["--policies", &name, "--seeds", "2"], mode, &SMALL].concat());
        let calls = std::fs::read_to_string(&log).expect("the calls");
        std::fs::remove_file(&log).expect("removable");
        calls
    };
    // The states of the warm-up, then each state.
    assert_eq!(calls(&["--states", "2"]), format!("{}{}", "c".repeat(4), "rc".repeat(4)));
    // Two synthetic rooms before each of two episodes.
    let calls = calls(&["--closed-loop", "--episodes", "1"]);
    assert!(calls.starts_with("ccrc") && calls.matches('r').count() == 2, "{calls}");
}
