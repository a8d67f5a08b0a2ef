//! The certificates of `--tls`.

use super::args::Args;
use super::check::Check;
use crate::commands::keys::first_end;

/// The certificate of the folder that ends first; nothing without `--tls`, or where the session has the fault of the
/// folder.
pub(super) fn check(args: &Args) -> Option<Check> {
    let folder = args.tls.tls.as_ref()?;
    match first_end(folder) {
        Ok(first) => {
            let (found, is_soon) = first?;
            let advice = "renew it on the machine with ca.key (heliostat keys renew), copy the folder, and restart its processes";
            Some(if is_soon { Check::warn("certificate", found, advice) } else { Check::ok("certificate", found) })
        }
        Err(_) if args.joins() => None,
        Err(error) => {
            Some(Check::fail("certificate", error.to_string(), "give --tls a folder that heliostat keys made"))
        }
    }
}
