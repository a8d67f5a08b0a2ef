//! The Python codec of the contract, run unchanged on the golden bytes.

use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use crate::common::*;

/// The codec that CONTRACT.md links to.
const CODEC: &str = include_str!("../../contract.py");

/// Checks of the codec on each sample.
const CHECKS: &str = r#"
def refused(payload, kind):
    try:
        decode(payload, kind)
    except Refused:
        return True
    return False

for kind, text in SAMPLES.items():
    payload = bytes.fromhex(text)
    message = decode(payload, kind)
    assert encode(message, kind) == payload, kind
    for length in range(len(payload)):
        assert refused(payload[:length], kind), (kind, length)
    assert refused(payload + b"\0", kind), kind
    assert refused(b"\2" + payload[1:], kind), kind
    assert refused(payload, kind % 22 + 1), kind

command = decode(bytes.fromhex(SAMPLES[4]), 4)
assert command == {"epoch": 7, "sequence": 300, "answers": 1000, "time_ns": 1767323045678000000, "validity_ms": 200,
                   "roll": [0.125, -0.5], "yaw": [0.0, 0.25]}, command
telemetry = decode(bytes.fromhex(SAMPLES[5]), 5)
assert telemetry["counters"]["expired"] == 6 and telemetry["temperature_c"] == 36.5, telemetry
assert telemetry["roll_measured"] == [0.125, -0.375] and telemetry["unusable"] == [1], telemetry

nan = bytes.fromhex(SAMPLES[4])[:-4] + struct.pack("<f", math.nan)
assert refused(nan, 4)
assert refused(bytes(MAX_PAYLOAD + 1), 4)
for wrong in [dict(command, yaw=[0.0]), dict(command, roll=[math.nan, 0.0]), dict(command, epoch=1 << 64)]:
    try:
        encode(wrong, 4)
        raise AssertionError(wrong)
    except Refused:
        pass
memory = decode(bytes.fromhex(SAMPLES[17]), 17)
assert memory["state"] == bytes([1, 2, 255]) and memory["inputs"][1]["input"] == 4, memory
for wrong in [dict(memory, state=bytes(786433)), dict(memory, inputs=[dict(memory["inputs"][0], input=10)])]:
    try:
        encode(wrong, 17)
        raise AssertionError(wrong.keys())
    except Refused:
        pass
orientation = decode(bytes.fromhex(SAMPLES[18]), 18)
assert orientation["users"] == [{"user": 3, "quaternion": [0.5, -0.5, 0.5, 0.5]}], orientation
for wrong in [[1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]]:
    try:
        encode(dict(orientation, users=[{"user": 3, "quaternion": wrong}]), 18)
        raise AssertionError(wrong)
    except Refused:
        pass
branches = decode(bytes.fromhex(SAMPLES[19]), 19)
assert branches["users"] == [{"user": 3, "los_gain": [0.0, 0.25], "irs_gain": [0.5, 0.125]}], branches
for wrong in [{"los_gain": [0.5]}, {"irs_gain": [0.5, -0.125]}, {"los_gain": [0.5] * 17, "irs_gain": [0.5] * 17}]:
    try:
        encode(dict(branches, users=[dict(branches["users"][0], **wrong)]), 19)
        raise AssertionError(wrong)
    except Refused:
        pass
leds = decode(bytes.fromhex(SAMPLES[22]), 22)
assert leds["users"][1] == {"user": 4, "serving": 0, "measures_each": False}, leds
assert leds["gains"][1] == {"user": 3, "led": 1, "los_gain": 0.5}, leds
try:
    encode(dict(leds, gains=[dict(leds["gains"][0], los_gain=-0.5)]), 22)
    raise AssertionError("a negative gain")
except Refused:
    pass
geometry = decode(bytes.fromhex(SAMPLES[15]), 15)
assert geometry["scenario"] == "[room]\nheight_m = 2.5\n", geometry
longest = dict(geometry, scenario="x" * 16384)
assert decode(encode(longest, 15), 15) == longest
for wrong, kind in [(dict(geometry, scenario="x" * 16385), 15),
                    (dict(decode(bytes.fromhex(SAMPLES[12]), 12), policy="x" * 1025), 12)]:
    try:
        encode(wrong, kind)
        raise AssertionError(kind)
    except Refused:
        pass
print("valid")
"#;

#[test]
fn the_codec_of_the_contract_decodes_and_encodes_the_golden_bytes() {
    let python = Command::new("python3").args(["-I", "-"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let mut python = match python {
        Ok(python) => python,
        Err(error) if std::env::var_os("CI").is_some() => panic!("python3 is required where CI is set: {error}"),
        Err(error) => {
            println!("skipped: python3 cannot be run: {error}");
            return;
        }
    };
    let mut script = CODEC.to_owned();
    script.push_str("\nSAMPLES = {\n");
    for (_, payload) in payloads() {
        writeln!(script, "    {}: \"{}\",", payload[1], hex(&payload)).expect("a string takes any text");
    }
    script.push_str("}\n");
    script.push_str(CHECKS);
    let mut input = python.stdin.take().expect("the input is piped");
    input.write_all(script.as_bytes()).expect("python3 reads the script");
    drop(input);
    let output = python.wait_with_output().expect("python3 exits");
    assert!(output.status.success(), "proto/contract.py fails; its error is printed above");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "valid");
}
