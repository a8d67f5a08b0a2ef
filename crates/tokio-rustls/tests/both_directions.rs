//! One thread reads a stream and another one writes it, as Zenoh does.

#![expect(unsafe_code, reason = "Zenoh shares a stream so")]

use std::cell::UnsafeCell;
use std::sync::Arc;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::{PrivateKeyDer, PrivatePkcs8KeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore, ServerConfig};
use tokio_rustls::{TlsAcceptor, TlsConnector, TlsStream, server};

/// A record of TLS 1.3 whose content no key has encrypted.
const FORGED: [u8; 37] = {
    let mut record = [7; 37];
    record[0] = 23;
    record[1] = 3;
    record[2] = 3;
    record[3] = 0;
    record[4] = 32;
    record
};

struct Shared(UnsafeCell<TlsStream<TcpStream>>);

// SAFETY: That each poll takes a lock is what these tests examine.
unsafe impl Sync for Shared {}

impl Shared {
    #[expect(clippy::mut_from_ref, reason = "Zenoh's link has this function")]
    fn stream(&self) -> &mut TlsStream<TcpStream> {
        // SAFETY: As above.
        unsafe { &mut *self.0.get() }
    }
}

/// Both ends of new connections.
struct Ends {
    listener: TcpListener,
    acceptor: TlsAcceptor,
    connector: TlsConnector,
}

impl Ends {
    async fn new() -> Self {
        let own = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
        let key = PrivateKeyDer::from(PrivatePkcs8KeyDer::from(own.signing_key.serialize_der()));
        let mut roots = RootCertStore::empty();
        roots.add(own.cert.der().clone()).expect("a root");
        let provider = Arc::new(default_provider());
        let accepting = ServerConfig::builder_with_provider(provider.clone()).with_safe_default_protocol_versions();
        let accepting = accepting.expect("versions").with_no_client_auth();
        let accepting =
            accepting.with_single_cert(vec![own.cert.der().clone()], key).expect("a key of its certificate");
        let connecting = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
        let connecting = connecting.expect("versions").with_root_certificates(roots).with_no_client_auth();
        Self {
            listener: TcpListener::bind("127.0.0.1:0").await.expect("a port"),
            acceptor: TlsAcceptor::from(Arc::new(accepting)),
            connector: TlsConnector::from(Arc::new(connecting)),
        }
    }

    async fn connect(&self) -> (Arc<Shared>, server::TlsStream<TcpStream>) {
        let socket = TcpStream::connect(self.listener.local_addr().expect("an address")).await.expect("a connection");
        let (other, _) = self.listener.accept().await.expect("a connection");
        for end in [&socket, &other] {
            end.set_nodelay(true).expect("an option of a socket");
        }
        let name = ServerName::try_from("localhost").expect("a name");
        let (near, far) = tokio::join!(self.connector.connect(name, socket), self.acceptor.accept(other));
        let near = TlsStream::Client(near.expect("a handshake"));
        (Arc::new(Shared(UnsafeCell::new(near))), far.expect("a handshake"))
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_connection_that_fails_while_it_is_written_gives_errors() {
    let ends = Ends::new().await;
    for _ in 0..300 {
        let (near, mut far) = ends.connect().await;
        let writing = near.clone();
        let writer = tokio::spawn(async move { while writing.stream().write_all(&[1; 64]).await.is_ok() {} });
        let reader = tokio::spawn(async move { near.stream().read_exact(&mut [0; 64]).await });
        let mut message = [0; 64];
        far.read_exact(&mut message).await.expect("a first message");
        far.get_mut().0.write_all(&FORGED).await.expect("bytes are sent");
        assert!(reader.await.expect("no panic").is_err(), "a forged record is an error");
        while far.read_exact(&mut message).await.is_ok() {}
        drop(far);
        writer.await.expect("no panic");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn what_is_written_in_both_directions_at_once_arrives() {
    const LENGTH: usize = 8_000_000;
    let content = |factor: usize| (0..LENGTH).map(move |index| (index * factor / 7) as u8).collect::<Vec<_>>();
    let (near, far) = Ends::new().await.connect().await;
    let far = Arc::new(Shared(UnsafeCell::new(TlsStream::Server(far))));
    let transfer = |from: Arc<Shared>, to: Arc<Shared>, content: Vec<u8>| {
        let sent = content.clone();
        let writer = tokio::spawn(async move {
            from.stream().write_all(&sent).await.expect("written");
            from.stream().flush().await.expect("flushed");
        });
        let reader = tokio::spawn(async move {
            let mut received = vec![0; LENGTH];
            to.stream().read_exact(&mut received).await.expect("read");
            assert!(received == content, "other bytes than those written");
        });
        async move {
            writer.await.expect("no panic");
            reader.await.expect("no panic");
        }
    };
    tokio::join!(transfer(near.clone(), far.clone(), content(3)), transfer(far, near, content(5)));
}
