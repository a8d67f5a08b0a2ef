//! The metrics that a process serves.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

/// The answer with the metrics at an address; empty without a response.
pub fn fetch_metrics(address: SocketAddr) -> String {
    let request = || -> std::io::Result<String> {
        let mut stream = TcpStream::connect(address)?;
        write!(stream, "GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(answer)
    };
    request().unwrap_or_default()
}

/// The value of the first sample with this prefix; not a number without one.
pub fn sample_value(page: &str, sample: &str) -> f64 {
    let line = page.lines().find(|line| line.starts_with(sample));
    line.and_then(|line| line.rsplit(' ').next()?.parse().ok()).unwrap_or(f64::NAN)
}
