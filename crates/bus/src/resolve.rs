//! The addresses of a name, within a limited time.
//!
//! The system has no limit for a name server that does not answer. A thread asks it, and is left behind after the limit.
//! There is one thread for each name: a later search for the name joins the one that still runs.

use std::collections::BTreeMap;
use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use zenoh::config::EndPoint;

/// Longest wait for a search: shorter than that for a connection, [`ACCEPTS_WITHIN`](crate::ACCEPTS_WITHIN).
const RESOLVED_WITHIN: Duration = Duration::from_secs(1);

/// The protocols whose endpoints have a host.
const WITH_HOST: [&str; 3] = ["tcp", "tls", "quic"];

/// The searches that run, by address.
static SEARCHES: Mutex<BTreeMap<String, Arc<Search>>> = Mutex::new(BTreeMap::new());

/// Why a name gives no address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoAddress {
    /// The system knows none.
    Unknown,
    /// The system has not answered within the limit.
    TimedOut,
}

/// A search for the addresses of a name.
struct Search {
    begun: Instant,
    /// What the system has answered; absent before that.
    found: Mutex<Option<Result<Vec<SocketAddr>, NoAddress>>>,
    changed: Condvar,
}

/// The addresses of `HOST:PORT`.
pub(crate) fn resolve(address: &str) -> Result<Vec<SocketAddr>, NoAddress> {
    match address.parse() {
        Ok(known) => Ok(vec![known]),
        Err(_) => begin(address, ask_system).wait(RESOLVED_WITHIN),
    }
}

/// That the name of one of these endpoints has no address, or none within the limit, in words. All are searched at a time.
pub(crate) fn first_unresolved(endpoints: &[String]) -> Option<String> {
    let of = |endpoint: &String| Some((endpoint.clone(), address_of(endpoint)?));
    let addresses: Vec<(String, String)> = endpoints.iter().filter_map(of).collect();
    let is_name = |address: &String| address.parse::<SocketAddr>().is_err();
    addresses.iter().filter(|(_, address)| is_name(address)).for_each(|(_, address)| drop(begin(address, ask_system)));
    addresses.iter().find_map(|(endpoint, address)| Some(describe(endpoint, address, resolve(address).err()?)))
}

fn describe(endpoint: &str, address: &str, reason: NoAddress) -> String {
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let limit_s = RESOLVED_WITHIN.as_secs_f64();
    match reason {
        NoAddress::Unknown => format!("{endpoint}: the name {host} has no address: correct it, or name an address"),
        NoAddress::TimedOut => {
            format!("{endpoint}: the name {host} was not resolved within {limit_s} s: name an address")
        }
    }
}

/// `HOST:PORT` of an endpoint that has a host.
fn address_of(endpoint: &str) -> Option<String> {
    let parsed: EndPoint = endpoint.parse().ok()?;
    WITH_HOST.contains(&parsed.protocol().as_str()).then(|| parsed.address().as_str().to_owned())
}

fn ask_system(address: &str) -> Result<Vec<SocketAddr>, NoAddress> {
    address.to_socket_addrs().map(Iterator::collect).map_err(|_| NoAddress::Unknown)
}

/// The search for an address that runs, or a new one, which calls `ask` on a thread of its own.
fn begin(address: &str, ask: impl FnOnce(&str) -> Result<Vec<SocketAddr>, NoAddress> + Send + 'static) -> Arc<Search> {
    let mut searches = lock(&SEARCHES);
    if let Some(search) = searches.get(address) {
        return Arc::clone(search);
    }
    let search = Arc::new(Search { begun: Instant::now(), found: Mutex::new(None), changed: Condvar::new() });
    let (of_thread, key) = (Arc::clone(&search), address.to_owned());
    let thread = thread::Builder::new().name("resolve".into()).spawn(move || {
        let found = ask(&key);
        // A later search asks again.
        lock(&SEARCHES).remove(&key);
        of_thread.end(found);
    });
    match thread {
        Ok(_) => drop(searches.insert(address.to_owned(), Arc::clone(&search))),
        Err(_) => search.end(Err(NoAddress::Unknown)),
    }
    search
}

impl Search {
    /// Notes the answer.
    fn end(&self, found: Result<Vec<SocketAddr>, NoAddress>) {
        *lock(&self.found) = Some(found);
        self.changed.notify_all();
    }

    /// The answer, if it comes within the limit since the beginning of the search.
    fn wait(&self, limit: Duration) -> Result<Vec<SocketAddr>, NoAddress> {
        let left = limit.saturating_sub(self.begun.elapsed());
        let waited = self.changed.wait_timeout_while(lock(&self.found), left, |found| found.is_none());
        let (found, _) = waited.unwrap_or_else(PoisonError::into_inner);
        found.clone().unwrap_or(Err(NoAddress::TimedOut))
    }
}

/// Waits for the lock, also after a panic of another thread: each value behind one is replaced as a unit.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn a_name_that_is_not_resolved_in_time_is_left_behind_and_searched_once() {
        let (address, at) = ("silent.example:7447", SocketAddr::from(([127, 0, 0, 1], 7447)));
        let (answer, answered) = mpsc::channel::<()>();
        let search = begin(address, move |_| {
            // Until the test lets the name server answer.
            let _ = answered.recv();
            Ok(vec![at])
        });
        assert_eq!(search.wait(Duration::ZERO), Err(NoAddress::TimedOut));
        let second = begin(address, |_| Err(NoAddress::Unknown));
        assert!(Arc::ptr_eq(&search, &second), "no second thread waits for the same answer");
        drop(answer);
        assert_eq!(second.wait(Duration::MAX), Ok(vec![at]));
        let other = begin("unknown.example:7447", |_| Err(NoAddress::Unknown));
        assert_eq!(other.wait(Duration::MAX), Err(NoAddress::Unknown));
    }

    #[test]
    fn an_endpoint_whose_name_has_no_address_is_named_with_what_to_do() {
        assert_eq!(address_of("tcp/lab.example:7447").as_deref(), Some("lab.example:7447"));
        assert_eq!(address_of("unixsock-stream/lab.sock"), None);
        let described = |reason| describe("tcp/lab.example:7447", "lab.example:7447", reason);
        assert_eq!(
            [NoAddress::TimedOut, NoAddress::Unknown].map(described),
            [
                "tcp/lab.example:7447: the name lab.example was not resolved within 1 s: name an address",
                "tcp/lab.example:7447: the name lab.example has no address: correct it, or name an address"
            ]
        );
        let at = SocketAddr::from(([127, 0, 0, 1], 7447));
        assert_eq!(resolve("127.0.0.1:7447"), Ok(vec![at]), "an address is asked of no name server");
        assert_eq!(first_unresolved(&["tcp/127.0.0.1:7447".to_owned()]), None);
    }
}
