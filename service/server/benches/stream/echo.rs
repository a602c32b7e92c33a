//! The floor: bytes in, as many bytes out as an answer has, without looking at them.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// Serves until it is stopped. A connection begins with two lengths, u32 each: of a question and of an answer.
pub(crate) async fn serve(port: u16) {
    let listener = TcpListener::bind(("127.0.0.1", port)).await.expect("the port");
    loop {
        let (stream, _) = listener.accept().await.expect("a connection");
        tokio::spawn(answer(stream));
    }
}

async fn answer(mut stream: TcpStream) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let mut head = [0; 8];
    stream.read_exact(&mut head).await?;
    if &head[..4] == b"GET " {
        // Whoever starts this process asks whether it is there.
        return stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\nconnection: close\r\n\r\n").await;
    }
    let length =
        |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]) as usize;
    let (mut question, answer) = (vec![0; length(0)], vec![0; length(4)]);
    loop {
        stream.read_exact(&mut question).await?;
        stream.write_all(&answer).await?;
    }
}
