//! A client of one connection that sends and waits, and nothing else: no runtime wakes a thread of its own while a
//! server is timed.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// One connection, kept.
pub(crate) struct Lone {
    stream: BufReader<TcpStream>,
    headers: String,
}

impl Lone {
    /// Connects to an address such as `http://127.0.0.1:80`; `headers` (each with its CR LF) go with every request.
    pub(crate) fn connect(address: &str, headers: &str) -> Self {
        let host = address.strip_prefix("http://").expect("an address of plain HTTP");
        let stream = TcpStream::connect(host).expect("a connection");
        stream.set_nodelay(true).expect("a socket");
        Self {
            stream: BufReader::with_capacity(1 << 16, stream),
            headers: format!("host: {host}\r\n{headers}"),
        }
    }

    /// Gets a path: how long it took, the status and the bytes of the answer's body.
    pub(crate) fn get(&mut self, path: &str) -> (Duration, u16, usize) {
        let request = format!("GET {path} HTTP/1.1\r\n{}\r\n", self.headers);
        self.exchange(request.as_bytes())
    }

    /// Posts a body: how long it took, the status and the bytes of the answer's body.
    pub(crate) fn post(&mut self, path: &str, body: &[u8]) -> (Duration, u16, usize) {
        let length = body.len();
        let head = format!("POST {path} HTTP/1.1\r\n{}content-length: {length}\r\n\r\n", self.headers);
        self.exchange(&[head.as_bytes(), body].concat())
    }

    fn exchange(&mut self, request: &[u8]) -> (Duration, u16, usize) {
        let begun = Instant::now();
        self.stream.get_mut().write_all(request).expect("sent");
        let (status, bytes) = self.answer();
        (begun.elapsed(), status, bytes)
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.stream.read_line(&mut line).expect("a line");
        line.trim_end().to_ascii_lowercase()
    }

    fn skip(&mut self, bytes: usize) {
        let mut body = (&mut self.stream).take(bytes as u64);
        let read = std::io::copy(&mut body, &mut std::io::sink()).expect("a whole answer");
        assert_eq!(read, bytes as u64, "a whole answer");
    }

    fn answer(&mut self) -> (u16, usize) {
        let first = self.line();
        let status = first.split(' ').nth(1).and_then(|text| text.parse().ok()).expect("a status");
        let (mut length, mut chunked) = (0, false);
        loop {
            let line = self.line();
            match line.split_once(':') {
                Some(("content-length", text)) => length = text.trim().parse().expect("a length"),
                Some(("transfer-encoding", text)) => chunked = text.trim() == "chunked",
                Some(_) => {}
                None => break,
            }
        }
        if !chunked {
            self.skip(length);
            return (status, length);
        }
        let mut bytes = 0;
        loop {
            let chunk = usize::from_str_radix(&self.line(), 16).expect("a chunk's length");
            self.skip(chunk);
            assert_eq!(self.line(), "", "a chunk's end");
            if chunk == 0 {
                return (status, bytes);
            }
            bytes += chunk;
        }
    }
}
