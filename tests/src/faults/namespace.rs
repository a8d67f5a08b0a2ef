//! Network namespaces, and virtual links between them that can be interrupted.

use std::io::Write as _;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU8, Ordering};

/// Distinguishes the namespaces of one process.
static COUNT: AtomicU8 = AtomicU8::new(0);

/// A network namespace with a link that can be interrupted, and one that stays up for a witness.
pub struct Link {
    name: String,
    /// First bytes of the addresses on the interruptible and on the other link.
    nets: [String; 2],
}

impl Link {
    /// Creates the namespace.
    ///
    /// # Panics
    /// When that is not permitted.
    pub fn create() -> Self {
        let number = COUNT.fetch_add(1, Ordering::SeqCst);
        let process = std::process::id();
        let octet = 64 + process % 128;
        let link = Self {
            name: format!("heliostat-{process}-{number}"),
            nets: [0, 1].map(|side| format!("10.{octet}.{}", 2 * number + side)),
        };
        assert!(link.set_up(), "no network namespace can be created");
        link
    }

    /// The program and arguments that start another program in the namespace.
    pub fn wrapper(&self) -> Vec<String> {
        ["ip", "netns", "exec", &self.name].map(str::to_owned).into()
    }

    /// Address inside the namespace that is reached over the interruptible link.
    pub fn address(&self) -> String {
        format!("{}.2", self.nets[0])
    }

    /// Address outside the namespace, at the other end of the interruptible link.
    pub fn host_address(&self) -> String {
        format!("{}.1", self.nets[0])
    }

    /// Address inside the namespace that is always reached.
    pub fn witness_address(&self) -> String {
        format!("{}.2", self.nets[1])
    }

    /// Interrupts the link: packets are lost in both directions.
    pub fn cut(&self) {
        assert!(ip(&format!("link set {} down", self.device(0))), "the link cannot be set down");
    }

    /// Ends the interruption.
    pub fn heal(&self) {
        assert!(ip(&format!("link set {} up", self.device(0))), "the link cannot be set up");
    }

    /// Loses this share of the packets in each direction, at random; `false` where that is not
    /// possible.
    pub fn lose(&self, percent: u32) -> bool {
        let (table, outer) = (self.table(), self.device(0));
        let rules = |device: &str| {
            format!(
                "table netdev {table} {{\nchain in {{\ntype filter hook ingress device \"{device}\" priority 0\n\
                 numgen random mod 100 < {percent} drop\n}}\n}}\n"
            )
        };
        nft(&[], &rules(&outer)) && nft(&["ip", "netns", "exec", &self.name], &rules("in0"))
    }

    /// Name of the table of rules that lose packets.
    fn table(&self) -> String {
        self.name.replace('-', "_")
    }

    /// Name of the end in this namespace; at most 15 characters.
    fn device(&self, side: usize) -> String {
        let (_, number) = self.name.rsplit_once('-').expect("the name ends in a number");
        format!("hs{}-{number}-{side}", std::process::id())
    }

    fn set_up(&self) -> bool {
        let name = &self.name;
        ip(&format!("netns add {name}"))
            && ip(&format!("-n {name} link set lo up"))
            && (0..2).all(|side| {
                let (device, net) = (self.device(side), &self.nets[side]);
                ip(&format!("link add {device} type veth peer name in{side} netns {name}"))
                    && ip(&format!("addr add {net}.1/24 dev {device}"))
                    && ip(&format!("-n {name} addr add {net}.2/24 dev in{side}"))
                    && ip(&format!("link set {device} up"))
                    && ip(&format!("-n {name} link set in{side} up"))
            })
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        nft(&[], &format!("delete table netdev {}\n", self.table()));
        // Its links disappear with it.
        ip(&format!("netns del {}", self.name));
    }
}

/// A link between two namespaces.
pub struct Cable {
    /// Names of the two namespaces.
    namespaces: [String; 2],
    /// First bytes of the addresses at both ends.
    net: String,
}

impl Cable {
    /// Links two namespaces.
    ///
    /// # Panics
    /// When the link cannot be made, although the namespaces could.
    pub fn between(first: &Link, second: &Link) -> Self {
        let (number, process) = (COUNT.fetch_add(1, Ordering::SeqCst), std::process::id());
        let net = format!("10.{}.{}", 64 + process % 128, 2 * number);
        let [one, other] = [&first.name, &second.name];
        let made = ip(&format!("-n {one} link add cable type veth peer name cable netns {other}"))
            && [(one, 1), (other, 2)].iter().all(|(name, end)| {
                ip(&format!("-n {name} addr add {net}.{end}/24 dev cable"))
                    && ip(&format!("-n {name} link set cable up"))
            });
        assert!(made, "the namespaces {one} and {other} cannot be linked");
        Self { namespaces: [one.clone(), other.clone()], net }
    }

    /// Address of an end, 0 or 1.
    pub fn address(&self, end: usize) -> String {
        format!("{}.{}", self.net, end + 1)
    }

    /// Interrupts the link: packets are lost in both directions.
    pub fn cut(&self) {
        assert!(ip(&format!("-n {} link set cable down", self.namespaces[0])), "the link cannot be set down");
    }

    /// Ends the interruption.
    pub fn heal(&self) {
        assert!(ip(&format!("-n {} link set cable up", self.namespaces[0])), "the link cannot be set up");
    }

    /// Loses this share of the packets in each direction, at random; `false` where that is not
    /// possible.
    pub fn lose(&self, percent: u32) -> bool {
        let rules = format!(
            "table netdev cable {{\nchain in {{\ntype filter hook ingress device \"cable\" priority 0\n\
             numgen random mod 100 < {percent} drop\n}}\n}}\n"
        );
        self.namespaces.iter().all(|name| nft(&["ip", "netns", "exec", name], &rules))
    }

    /// Ends the loss of packets.
    pub fn lose_none(&self) {
        for name in &self.namespaces {
            nft(&["ip", "netns", "exec", name], "delete table netdev cable\n");
        }
    }
}

/// Network namespaces on one network, each with a link of its own that can be interrupted. This namespace is on it too.
pub struct Segment {
    name: String,
    /// First bytes of the addresses.
    net: String,
    hosts: usize,
}

impl Segment {
    /// Creates the network with this number of namespaces.
    ///
    /// # Panics
    /// When that is not permitted.
    pub fn create(hosts: usize) -> Self {
        let (number, process) = (COUNT.fetch_add(1, Ordering::SeqCst), std::process::id());
        let net = format!("10.{}.{}", 64 + process % 128, 2 * number);
        let segment = Self { name: format!("hs{process}-{number}"), net, hosts };
        let Self { name, net, .. } = &segment;
        let made = ip(&format!("link add {name} type bridge"))
            && ip(&format!("addr add {net}.1/24 dev {name}"))
            && ip(&format!("link set {name} up"))
            && (0..hosts).all(|host| {
                let (own, device) = (segment.namespace(host), segment.device(host));
                let address = segment.address(host);
                ip(&format!("netns add {own}"))
                    && ip(&format!("-n {own} link set lo up"))
                    && ip(&format!("link add {device} type veth peer name in netns {own}"))
                    && ip(&format!("link set {device} master {name}"))
                    && ip(&format!("-n {own} addr add {address}/24 dev in"))
                    && ip(&format!("link set {device} up"))
                    && ip(&format!("-n {own} link set in up"))
            });
        assert!(made, "the network {name} cannot be made");
        segment
    }

    /// Address of this namespace.
    pub fn own_address(&self) -> String {
        format!("{}.1", self.net)
    }

    /// Address of a namespace.
    pub fn address(&self, host: usize) -> String {
        format!("{}.{}", self.net, host + 2)
    }

    /// The program and arguments that start another program in a namespace.
    pub fn wrapper(&self, host: usize) -> Vec<String> {
        ["ip", "netns", "exec", &self.namespace(host)].map(str::to_owned).into()
    }

    /// Interrupts the link of a namespace: packets are lost in both directions.
    pub fn cut(&self, host: usize) {
        assert!(ip(&format!("link set {} down", self.device(host))), "the link cannot be set down");
    }

    /// Ends the interruption.
    pub fn heal(&self, host: usize) {
        assert!(ip(&format!("link set {} up", self.device(host))), "the link cannot be set up");
    }

    fn namespace(&self, host: usize) -> String {
        format!("{}-{host}", self.name)
    }

    fn device(&self, host: usize) -> String {
        format!("{}p{host}", self.name)
    }
}

impl Drop for Segment {
    fn drop(&mut self) {
        for host in 0..self.hosts {
            ip(&format!("netns del {}", self.namespace(host)));
        }
        ip(&format!("link del {}", self.name));
    }
}

/// Whether `nft` applies these rules; a wrapper starts it in a namespace.
fn nft(wrapper: &[&str], rules: &str) -> bool {
    let command = [wrapper, &["nft", "-f", "-"]].concat();
    let child = Command::new(command[0])
        .args(&command[1..])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    child.is_ok_and(|mut child| {
        let is_written = child.stdin.take().is_some_and(|mut input| input.write_all(rules.as_bytes()).is_ok());
        child.wait().is_ok_and(|status| status.success()) && is_written
    })
}

/// Whether `ip` succeeds with these arguments.
fn ip(arguments: &str) -> bool {
    let output = Command::new("ip").args(arguments.split(' ')).output();
    output.is_ok_and(|output| output.status.success())
}
