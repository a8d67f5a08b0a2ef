//! The bytes of each message. A failure here is a change of the contract: correct the code, not the
//! test. The bytes of version 1 stay valid; different ones need a new version or a new kind.

use crate::common::*;
use heliostat_proto::{Message, decode};

fn check_bytes<T: Message + PartialEq + std::fmt::Debug>(message: &T, bytes: &str) {
    assert_eq!(hex(&encoded(message)), bytes, "bytes of a {}", T::KIND);
    assert_eq!(&decode::<T>(&unhex(bytes)).expect("golden bytes are valid"), message, "a decoded {}", T::KIND);
}

macro_rules! golden {
    ($($sample:ident = $bytes:literal;)*) => {
        /// The bytes of each message in hexadecimal digits, in the order of the kinds.
        const ALL: [&str; [$($bytes),*].len()] = [$($bytes),*];

        #[test]
        fn each_message_has_the_bytes_of_version_1() {
            $(check_bytes(&$sample(), $bytes);)*
        }
    };
}

golden! {
    user_report = "\
    0101f0bdf3d589cf959a12ac0280cffea7a4deb2c318e80701030000c03f000080be9a99593f0000003f000080bf00247449";
    channel_report = "\
    0102f0bdf3d589cf959a12ac0280cffea7a4deb2c318e807010300000000acc5a73500002a42";
    obstacle_report = "\
    0103f0bdf3d589cf959a12ac0280cffea7a4deb2c31801000080bf000000400000803e0000e03f";
    mirror_command = "\
    010407ac02e80780cffea7a4deb2c318c801020000003e000000bf02000000000000803e";
    mirror_telemetry = "\
    0105f0bdf3d589cf959a12ac0280cffea7a4deb2c3180107ac02e807c0d3bba8a4deb2c318e095daa8a4deb2c3180202ab02040102000506\
    000100001242020000003e000000bf02000000000000803e020000003e0000c0be000101";
    node_status = "\
    0106f0bdf3d589cf959a12ac0280cffea7a4deb2c3180106726f6f6d204105302e312e300772756e6e696e67066330666665650080cffea7\
    a4deb2c31801057469636b73e807010973706565645f6d5f73000000000000f83f01046c6f6f700200000000000059400000000000c06240\
    0000000000c062400000000000c062400000000000c0624002c2b5";
    room_truth = "\
    0107f0bdf3d589cf959a12ac0280cffea7a4deb2c318e80701030000c03f000080be9a99593f0000003f010000000000acc5a73500002a42\
    8096184a0024744901000080bf000000400000803e0000e03f00000000d012434100000000000000000000000080842e4100000000d01243\
    41";
    capabilities = "\
    0108f0bdf3d589cf959a12ac0280cffea7a4deb2c3180e4c6162207469702d74696c742032076c616220312e300102000080be0000803e00\
    0000410000003c00000039000000bf0000003f000000410000003c00000039010100007a44d00f0000000000000000";
    emergency_stop = "\
    0109f0bdf3d589cf959a12ac0280cffea7a4deb2c3180103616e6e05636c656172";
    calibration = "\
    010af0bdf3d589cf959a12ac0280cffea7a4deb2c318020000803c00000000020000803f0000843f0200000000000080bc020000803f0000\
    803f";
    simulator_control = "\
    010bf0bdf3d589cf959a12ac0280cffea7a4deb2c318010200010000803e0000c03f01030000003f0000803eac020201ac02";
    controller_control = "\
    010cf0bdf3d589cf959a12ac0280cffea7a4deb2c3180b66697865642d706f696e74";
    rearm = "\
    010df0bdf3d589cf959a12ac0280cffea7a4deb2c318f0bdf3d589cf959a12ac0203616e6e05636c656172";
    safety_report = "\
    010ef0bdf3d589cf959a12ac0280cffea7a4deb2c31801f0bdf3d589cf959a12ac0280cffea7a4deb2c31803616e6e047465737407904ee0\
    d403c0843d";
    room_geometry = "\
    010ff0bdf3d589cf959a12ac0280cffea7a4deb2c318165b726f6f6d5d0a6865696768745f6d203d20322e350a";
    belief_report = "\
    0110f0bdf3d589cf959a12ac0280cffea7a4deb2c318e807c09292afa4deb2c31801030000c03f000080be9a99593f0000003f000080bf00\
    00803d000000bd0000003e000000bf0000403f0000803e";
    controller_memory = "\
    0111f0bdf3d589cf959a12ac0280cffea7a4deb2c31807e8070200f0bdf3d589cf959a12ac0280cffea7a4deb2c3180004000080cffea7a4\
    deb2c31801030102ff";
    orientation_report = "\
    0112f0bdf3d589cf959a12ac0280cffea7a4deb2c31801030000003f000000bf0000003f0000003f";
    branch_report = "\
    0113f0bdf3d589cf959a12ac0280cffea7a4deb2c318e807010302000000000000803e020000003f0000003e";
    stop_report = "\
    0114f0bdf3d589cf959a12ac0280cffea7a4deb2c3180001f0bdf3d589cf959a12ac0280cffea7a4deb2c31803616e6e0474657374010701\
    076e6f206c696e6b";
    stop_repetition = "\
    0115f0bdf3d589cf959a12ac0280cffea7a4deb2c318070103616e6e0474657374";
    led_report = "\
    0116f0bdf3d589cf959a12ac0280cffea7a4deb2c318e80702030101010401000002030000\
    00803e03010000003f";
}

/// The numbers of each enumeration are those in CONTRACT.md.
#[test]
fn enumerations_keep_their_numbers() {
    use heliostat_proto::{ArrayState, FaultKind, InputKind, NodeKind};
    let states =
        [ArrayState::Parked, ArrayState::Following, ArrayState::Holding, ArrayState::Stopped, ArrayState::Fault];
    for (number, state) in states.into_iter().enumerate() {
        let payload = encoded(&heliostat_proto::MirrorTelemetry { state, ..Default::default() });
        assert_eq!(usize::from(payload[5]), number, "{state:?} follows the header and an empty stamp");
    }
    for (number, kind) in FaultKind::ALL.into_iter().enumerate() {
        let fault = heliostat_proto::MirrorFault { fault: kind, ..Default::default() };
        let payload = encoded(&heliostat_proto::SimulatorControl { faults: vec![fault], ..Default::default() });
        assert_eq!(
            usize::from(payload[9]),
            number,
            "{kind:?} follows the header, an empty stamp, three absent values and a length"
        );
    }
    for (number, node) in NodeKind::ALL.into_iter().enumerate() {
        let payload = encoded(&heliostat_proto::NodeStatus { node, ..Default::default() });
        assert_eq!(usize::from(payload[5]), number, "{node}");
    }
    for (number, input) in InputKind::ALL.into_iter().enumerate() {
        let inputs = vec![heliostat_proto::ControllerInput { input, ..Default::default() }];
        let payload = encoded(&heliostat_proto::ControllerMemory { inputs, ..Default::default() });
        assert_eq!(
            usize::from(payload[8]),
            number,
            "{input:?} follows the header, an empty stamp, two numbers, a length"
        );
    }
}

#[test]
fn the_contract_document_shows_the_same_bytes() {
    let document = include_str!("../../../CONTRACT.md");
    let shown: Vec<String> = document.split("```").map(|part| part.split_whitespace().skip(1).collect()).collect();
    assert_eq!(ALL.len(), payloads().len());
    for (bytes, (name, _)) in ALL.into_iter().zip(payloads()) {
        assert!(shown.iter().any(|part| part == bytes), "CONTRACT.md lacks the bytes of the {name}: {bytes}");
    }
}
