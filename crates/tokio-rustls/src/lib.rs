//! TLS streams that one thread may read while another one writes.
//!
//! Zenoh 1.10 reads a TLS link on one thread and writes it on another one, without a lock between them. The
//! streams of tokio-rustls do not allow this: both threads change the state of one connection. A process crashes,
//! for example, when the other side ends a connection while this side writes (issue 2557 of eclipse-zenoh/zenoh).
//! This package has the part of the interface of tokio-rustls that Zenoh uses. Each of its streams holds one of
//! futures-rustls behind a lock, which each poll takes. (That one has the author and the design of tokio-rustls, on
//! which a package of its name cannot depend.)
//!
//! A poll for reading and one for writing wake different tasks. The stream below writes in a poll for reading only
//! to send an alert before it fails.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

pub use futures_rustls::rustls;
use futures_rustls::rustls::pki_types::ServerName;
use futures_rustls::rustls::{ClientConfig, ClientConnection, CommonState, ServerConfig, ServerConnection};
use parking_lot::Mutex;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_util::compat::{Compat, FuturesAsyncReadCompatExt, TokioAsyncReadCompatExt};

/// Streams of the side that connects.
pub mod client {
    /// A connection of the side that connects.
    pub type TlsStream<IO> = crate::Locked<futures_rustls::client::TlsStream<crate::Compat<IO>>>;
}

/// Streams of the side that accepts.
pub mod server {
    /// A connection of the side that accepts.
    pub type TlsStream<IO> = crate::Locked<futures_rustls::server::TlsStream<crate::Compat<IO>>>;
}

/// A stream behind a lock that each poll takes.
///
/// The pointer keeps apart what two threads change: a caller that polls from both of them holds two exclusive
/// references to the pointer, which stays as it is.
#[derive(Debug)]
pub struct Locked<S>(Arc<Mutex<Compat<S>>>);

impl<S: Parts> Locked<S> {
    fn poll<T>(&self, poll: impl FnOnce(Pin<&mut Compat<S>>) -> T) -> T {
        poll(Pin::new(&mut self.0.lock()))
    }

    /// The socket and the state of the connection, without the lock: not while another thread polls.
    #[expect(unsafe_code, reason = "the interface of tokio-rustls gives references, not guards")]
    pub fn get_ref(&self) -> (&S::Socket, &S::Connection) {
        // SAFETY: The stream lives as long as `self`. Zenoh calls this before two threads share the stream: for the
        // certificate of the other side and the options of the socket.
        unsafe { &*self.0.data_ptr() }.get_ref().parts()
    }

    /// The socket and the state of the connection, without the lock. Zenoh shuts down the socket so while another
    /// thread may read: a call of the operating system that changes nothing here.
    pub fn get_mut(&mut self) -> (&mut S::Socket, &mut S::Connection) {
        Arc::get_mut(&mut self.0).expect("the pointer has no second holder").get_mut().get_mut().parts_mut()
    }
}

impl<S: Parts> AsyncRead for Locked<S> {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.poll(|stream| stream.poll_read(cx, buf))
    }
}

impl<S: Parts> AsyncWrite for Locked<S> {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        self.poll(|stream| stream.poll_write(cx, buf))
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll(|stream| stream.poll_flush(cx))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll(|stream| stream.poll_shutdown(cx))
    }
}

/// A stream of futures-rustls as its socket and the state of its connection.
pub trait Parts: futures_io::AsyncRead + futures_io::AsyncWrite + Unpin {
    /// What carries the encrypted bytes.
    type Socket;

    /// The state of the connection.
    type Connection;

    /// Both parts.
    fn parts(&self) -> (&Self::Socket, &Self::Connection);

    /// Both parts, to change them.
    fn parts_mut(&mut self) -> (&mut Self::Socket, &mut Self::Connection);
}

impl<IO: AsyncRead + AsyncWrite + Unpin> Parts for futures_rustls::client::TlsStream<Compat<IO>> {
    type Socket = IO;
    type Connection = ClientConnection;

    fn parts(&self) -> (&IO, &ClientConnection) {
        let (socket, connection) = self.get_ref();
        (socket.get_ref(), connection)
    }

    fn parts_mut(&mut self) -> (&mut IO, &mut ClientConnection) {
        let (socket, connection) = self.get_mut();
        (socket.get_mut(), connection)
    }
}

impl<IO: AsyncRead + AsyncWrite + Unpin> Parts for futures_rustls::server::TlsStream<Compat<IO>> {
    type Socket = IO;
    type Connection = ServerConnection;

    fn parts(&self) -> (&IO, &ServerConnection) {
        let (socket, connection) = self.get_ref();
        (socket.get_ref(), connection)
    }

    fn parts_mut(&mut self) -> (&mut IO, &mut ServerConnection) {
        let (socket, connection) = self.get_mut();
        (socket.get_mut(), connection)
    }
}

/// A connection of either side.
#[derive(Debug)]
pub enum TlsStream<IO> {
    /// Of the side that connects.
    Client(client::TlsStream<IO>),
    /// Of the side that accepts.
    Server(server::TlsStream<IO>),
}

impl<IO: AsyncRead + AsyncWrite + Unpin> TlsStream<IO> {
    /// The socket and the state of the connection, without the lock: not while another thread polls.
    pub fn get_ref(&self) -> (&IO, &CommonState) {
        match self {
            Self::Client(stream) => {
                let (socket, connection) = stream.get_ref();
                (socket, connection)
            }
            Self::Server(stream) => {
                let (socket, connection) = stream.get_ref();
                (socket, connection)
            }
        }
    }

    /// The socket and the state of the connection.
    pub fn get_mut(&mut self) -> (&mut IO, &mut CommonState) {
        match self {
            Self::Client(stream) => {
                let (socket, connection) = stream.get_mut();
                (socket, connection)
            }
            Self::Server(stream) => {
                let (socket, connection) = stream.get_mut();
                (socket, connection)
            }
        }
    }
}

impl<IO: AsyncRead + AsyncWrite + Unpin> AsyncRead for TlsStream<IO> {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Client(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Server(stream) => Pin::new(stream).poll_read(cx, buf),
        }
    }
}

impl<IO: AsyncRead + AsyncWrite + Unpin> AsyncWrite for TlsStream<IO> {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Client(stream) => Pin::new(stream).poll_write(cx, buf),
            Self::Server(stream) => Pin::new(stream).poll_write(cx, buf),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Client(stream) => Pin::new(stream).poll_flush(cx),
            Self::Server(stream) => Pin::new(stream).poll_flush(cx),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Client(stream) => Pin::new(stream).poll_shutdown(cx),
            Self::Server(stream) => Pin::new(stream).poll_shutdown(cx),
        }
    }
}

/// Handshakes of the side that connects.
#[derive(Clone)]
pub struct TlsConnector(futures_rustls::TlsConnector);

impl TlsConnector {
    /// Begins a handshake with the process of this name at the other end of the socket.
    pub fn connect<IO: AsyncRead + AsyncWrite + Unpin>(&self, name: ServerName<'static>, socket: IO) -> Connect<IO> {
        Handshake(self.0.connect(name, socket.compat()))
    }
}

impl From<Arc<ClientConfig>> for TlsConnector {
    fn from(config: Arc<ClientConfig>) -> Self {
        Self(config.into())
    }
}

/// Handshakes of the side that accepts.
#[derive(Clone)]
pub struct TlsAcceptor(futures_rustls::TlsAcceptor);

impl TlsAcceptor {
    /// Begins a handshake with the process at the other end of the socket.
    pub fn accept<IO: AsyncRead + AsyncWrite + Unpin>(&self, socket: IO) -> Accept<IO> {
        Handshake(self.0.accept(socket.compat()))
    }
}

impl From<Arc<ServerConfig>> for TlsAcceptor {
    fn from(config: Arc<ServerConfig>) -> Self {
        Self(config.into())
    }
}

/// A handshake of the side that connects.
pub type Connect<IO> = Handshake<futures_rustls::Connect<Compat<IO>>>;

/// A handshake of the side that accepts.
pub type Accept<IO> = Handshake<futures_rustls::Accept<Compat<IO>>>;

/// A handshake whose result is a stream behind a lock.
pub struct Handshake<F>(F);

impl<S: Parts, F: Future<Output = io::Result<S>> + Unpin> Future for Handshake<F> {
    type Output = io::Result<Locked<S>>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        Pin::new(&mut self.0).poll(cx).map_ok(|stream| Locked(Arc::new(Mutex::new(stream.compat()))))
    }
}
