//! Decoding any bytes yields a valid message or a named refusal.

use crate::common::*;
use heliostat_proto::*;
use proptest::prelude::*;

/// Decodes the payload as every kind; an accepted message must survive a round trip.
fn decodes_or_refuses(payload: &[u8]) -> Result<(), TestCaseError> {
    fn one<T: Message + PartialEq + std::fmt::Debug>(payload: &[u8]) -> Result<(), TestCaseError> {
        let Ok(message) = decode::<T>(payload) else { return Ok(()) };
        let mut again = Vec::new();
        prop_assert_eq!(encode(&message, &mut again), Ok(()));
        prop_assert!(again.len() <= payload.len(), "numbers are encoded in their shortest form");
        prop_assert_eq!(decode::<T>(&again), Ok(message));
        Ok(())
    }
    macro_rules! as_each {
        ($($message:ident $sample:ident,)*) => { [$(one::<$message>(payload)),*] };
    }
    each_message!(as_each).into_iter().collect()
}

fn finite() -> impl Strategy<Value = f32> {
    any::<f32>().prop_filter("finite", |value| value.is_finite())
}

prop_compose! {
    fn commands()(
        head in any::<(u64, u64, u64, u64, u32)>(),
        angles in prop::collection::vec((finite(), finite()), 0..200),
    ) -> MirrorCommand {
        let (epoch, sequence, answers, time_ns, validity_ms) = head;
        let (roll, yaw) = angles.into_iter().unzip();
        MirrorCommand { epoch, sequence, answers, time_ns, validity_ms, roll, yaw }
    }
}

prop_compose! {
    fn reports()(
        head in any::<(u64, u64, u64, u64)>(),
        users in prop::collection::vec((any::<u32>(), [finite(), finite(), finite()], finite()), 0..MAX_USERS),
    ) -> UserReport {
        let (source, sequence, time_ns, tick) = head;
        let state = |(user, position_m, rate): (u32, [f32; 3], f32)| UserState {
            user,
            position_m,
            velocity_m_s: [position_m[0], rate],
            min_rate_bps: rate.abs(),
        };
        UserReport { stamp: Stamp { source, sequence, time_ns }, tick, users: users.into_iter().map(state).collect() }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn random_bytes_are_decoded_or_refused(mut payload in prop::collection::vec(any::<u8>(), 0..400), kind in 0u8..20) {
        decodes_or_refuses(&payload)?;
        if payload.len() >= 2 {
            payload[0] = VERSION;
            payload[1] = kind;
            decodes_or_refuses(&payload)?;
        }
    }

    #[test]
    fn altered_payloads_are_decoded_or_refused(
        which in any::<prop::sample::Index>(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut payloads = payloads();
        let which = which.index(payloads.len());
        let mut payload = payloads.swap_remove(which).1;
        for (at, byte) in edits {
            let at = at.index(payload.len());
            payload[at] = byte;
        }
        decodes_or_refuses(&payload)?;
        payload.truncate(cut.index(payload.len()));
        decodes_or_refuses(&payload)?;
    }

    #[test]
    fn commands_survive_a_round_trip(command in commands()) {
        prop_assert_eq!(decode(&encoded(&command)), Ok(command));
    }

    #[test]
    fn reports_survive_a_round_trip(report in reports()) {
        prop_assert_eq!(decode(&encoded(&report)), Ok(report));
    }
}
