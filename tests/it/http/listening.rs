//! A server at its socket, before a store of the story's own, with a machine, a tool and an operation.

use super::app::{NOW, machine, operation, tool};
use feedwright_server::clock::Clock;
use feedwright_server::config::{Config, Sources};
use feedwright_server::server::{RunningServer, Server};
use feedwright_store::Store;
use secrecy::ExposeSecret;
use std::sync::Arc;
use std::time::Duration;

pub(super) struct Listening {
    pub(super) server: RunningServer,
    /// `http://` and where it listens.
    pub(super) address: String,
    pub(super) client: reqwest::Client,
    /// The first admin's token.
    pub(super) admin: String,
    pub(super) dir: tempfile::TempDir,
}

impl Listening {
    pub(super) async fn before(store: Arc<dyn Store>) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let flags = [("data_dir", dir.path().to_str().unwrap()), ("server.listen", "127.0.0.1:0")];
        let flags = flags.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
        let config = Config::load(&Sources { flags, ..Sources::default() }).unwrap();
        let server = Server::start(config, store, Clock::fixed(NOW)).await.unwrap();
        let admin = server.first_admin_token.as_ref().unwrap().expose_secret().to_owned();
        let client = reqwest::Client::builder().timeout(Duration::from_secs(32)).build().unwrap();
        let address = format!("http://{}", server.local_addr);
        for (path, body) in [("machines/M1", machine()), ("tools/T1", tool()), ("operations/O1", operation())]
        {
            let put = client.put(format!("{address}/v1/{path}")).bearer_auth(&admin).json(&body);
            assert_eq!(put.send().await.unwrap().status().as_u16(), 201, "{path}");
        }
        Self { server, address, client, admin, dir }
    }
}
