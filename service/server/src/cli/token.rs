//! `feedwright token`: through the server when one runs, else directly in its database.

use super::{Settings, print};
use crate::auth::{Issued, Token};
use crate::clock::Clock;
use crate::config::Config;
use crate::data_dir::DataDirError;
use crate::database::{self, Database, OpenError};
use crate::http::dto::token::{NewToken, TokenBody, TokenRequest, TokenView};
use crate::http::dto::word::RoleWord;
use anyhow::{Context, bail, ensure};
use clap::{Args, Subcommand};
use feedwright_core::invalid::Violation;
use feedwright_store::{Actor, Page, Role, Store};
use reqwest::{Method, RequestBuilder, Response};
use secrecy::{ExposeSecret, SecretString};
use serde::Deserialize;
use std::ffi::OsString;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Longest wait for an answer of the server.
const PATIENCE: Duration = Duration::from_secs(30);
/// Tokens asked for at a time.
const PAGE: u32 = 500;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The server to go through, where it is not found by its data directory.
    #[arg(long, global = true, value_name = "URL")]
    server: Option<String>,
    /// An admin's token, for going through a server. [env: FEEDWRIGHT_TOKEN]
    #[arg(long, global = true, value_parser = secret, conflicts_with = "token_file")]
    token: Option<SecretString>,
    /// A file that holds an admin's token. [env: FEEDWRIGHT_TOKEN_FILE]
    // The environment is read here and not by clap, which does not tell a flag from a variable: the flag goes before either.
    #[arg(long, global = true, value_name = "FILE")]
    token_file: Option<PathBuf>,
    #[command(subcommand)]
    command: TokenCommand,
}

#[derive(Debug, Subcommand)]
enum TokenCommand {
    /// Makes a token and prints it: the only time that it is shown.
    Create {
        /// What people call it.
        #[arg(long)]
        name: String,
        /// machine, viewer, engineer, approver or admin.
        #[arg(long, value_parser = role)]
        role: Role,
        /// The machine that it is bound to, for the role machine.
        #[arg(long)]
        machine: Option<String>,
    },
    /// Lists tokens, revoked ones too.
    List,
    /// Revokes a token: its next request is refused.
    Revoke {
        /// Its id: the part between the first two underscores. What begins as the token does is taken too, up to the whole of it.
        #[arg(value_parser = secret)]
        id: SecretString,
    },
}

// Never fails; an infallible function is no parser for clap's derive.
fn secret(text: &str) -> Result<SecretString, String> {
    Ok(SecretString::from(text))
}

fn role(text: &str) -> Result<Role, String> {
    Role::parse(text).ok_or_else(|| Role::ALL.map(Role::as_str).join(", "))
}

/// Where the tokens are reached.
enum Way {
    Server(Remote),
    Database(Database),
}

/// Runs the command.
pub async fn run(settings: &Settings, arguments: Arguments) -> anyhow::Result<()> {
    let way = way(settings.load(Vec::new())?, &arguments).await?;
    let result = match &way {
        Way::Server(server) => through_server(server, arguments.command).await,
        Way::Database(database) => in_database(&database.store, arguments.command).await,
    };
    if let Way::Database(database) = way {
        database.store.close().await;
    }
    result
}

async fn way(config: Config, arguments: &Arguments) -> anyhow::Result<Way> {
    if let Some(server) = &arguments.server {
        return Ok(Way::Server(Remote::new(server, arguments)?));
    }
    // The data directory is locked as long as a server runs on it, and says where that server listens.
    match database::open(&config).await {
        Ok(database) => Ok(Way::Database(database)),
        Err(OpenError::DataDir(DataDirError::InUse { address: Some(address), .. })) => {
            let listen = address.parse().context("the lock file holds no address")?;
            // An admin's token goes only to whom its name is verified of.
            ensure!(
                !config.tls.is_on(),
                "a server with TLS runs here: give its name with --server https://…"
            );
            let url = format!("http://{}", super::healthcheck::reachable(listen));
            Ok(Way::Server(Remote::new(&url, arguments)?))
        }
        Err(error) => Err(error.into()),
    }
}

/// The token that was given, or where it is.
enum Given {
    Token(SecretString),
    File(PathBuf),
}

impl Given {
    /// A flag goes before the environment, whichever of the two each is.
    fn of(
        arguments: &Arguments,
        environment: impl Fn(&str) -> Option<OsString>,
    ) -> anyhow::Result<Option<Self>> {
        if let Some(token) = &arguments.token {
            return Ok(Some(Self::Token(token.clone())));
        }
        if let Some(file) = &arguments.token_file {
            return Ok(Some(Self::File(file.clone())));
        }
        let set = |name| environment(name).filter(|value| !value.is_empty());
        if let Some(token) = set("FEEDWRIGHT_TOKEN") {
            let text = token.into_string().map_err(|_| anyhow::anyhow!("FEEDWRIGHT_TOKEN is not UTF-8"))?;
            return Ok(Some(Self::Token(text.into())));
        }
        Ok(set("FEEDWRIGHT_TOKEN_FILE").map(|file| Self::File(file.into())))
    }
}

/// A server, and the token to talk to it with.
struct Remote {
    client: reqwest::Client,
    url: String,
    token: SecretString,
}

impl Remote {
    fn new(url: &str, arguments: &Arguments) -> anyhow::Result<Self> {
        let given = Given::of(arguments, |name| std::env::var_os(name))?;
        let token = match given {
            Some(Given::Token(token)) => token,
            Some(Given::File(file)) => {
                let text = std::fs::read_to_string(&file)
                    .with_context(|| format!("cannot read {}", file.display()))?;
                SecretString::from(text.trim())
            }
            None => {
                bail!(
                    "a server runs at {url}: give an admin's token with --token-file, or in FEEDWRIGHT_TOKEN"
                )
            }
        };
        let client = crate::tls::client(url).timeout(PATIENCE).build()?;
        Ok(Self { client, url: format!("{}/v1/tokens", url.trim_end_matches('/')), token })
    }

    fn request(&self, method: Method, rest: &str) -> RequestBuilder {
        self.client.request(method, format!("{}{rest}", self.url)).bearer_auth(self.token.expose_secret())
    }
}

/// What is read of a problem document.
#[derive(Deserialize)]
struct Refusal {
    code: String,
    detail: String,
}

async fn accepted(response: Response) -> anyhow::Result<Response> {
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    match response.json::<Refusal>().await {
        // What is said of a field ends in its code.
        Ok(Refusal { code, detail }) if detail.ends_with(&format!("({code})")) => {
            bail!("the server refuses: {detail}")
        }
        Ok(Refusal { code, detail }) => bail!("the server refuses: {detail} ({code})"),
        Err(_) => bail!("the server answers {status}"),
    }
}

#[derive(Deserialize)]
struct TokenPage {
    items: Vec<TokenView>,
    next_cursor: Option<String>,
}

async fn through_server(server: &Remote, command: TokenCommand) -> anyhow::Result<()> {
    match command {
        TokenCommand::Create { name, role, machine } => {
            let body = TokenBody { name, role: RoleWord(role), machine };
            let response = server.request(Method::POST, "").json(&body).send().await?;
            let made: NewToken = accepted(response).await?.json().await?;
            let Err(unshown) = show(&made.token) else { return Ok(()) };
            let response = server.request(Method::DELETE, &format!("/{}", made.kept.id)).send().await;
            let revoked = match response {
                Ok(response) => accepted(response).await.map(drop),
                Err(error) => Err(error.into()),
            };
            Err(not_shown(&made.kept.id, &unshown, revoked))
        }
        TokenCommand::List => {
            let mut rest = format!("?limit={PAGE}");
            loop {
                let response = server.request(Method::GET, &rest).send().await?;
                let page: TokenPage = accepted(response).await?.json().await?;
                print_rows(&page.items)?;
                let Some(cursor) = page.next_cursor else { return Ok(()) };
                rest = format!("?limit={PAGE}&cursor={cursor}");
            }
        }
        TokenCommand::Revoke { id } => {
            let id = id_of(&id)?;
            let response = server.request(Method::DELETE, &format!("/{id}")).send().await?;
            accepted(response).await?;
            print(&format!("revoked {id}\n"))
        }
    }
}

async fn in_database(store: &Arc<dyn Store>, command: TokenCommand) -> anyhow::Result<()> {
    let (clock, actor) = (Clock::system(), Actor { token: "cli".to_owned(), role: Role::Admin });
    match command {
        TokenCommand::Create { name, role, machine } => {
            let body = TokenBody { name, role: RoleWord(role), machine };
            let TokenRequest { name, role, machine } =
                body.try_into().map_err(|wrong: Vec<_>| refused(&wrong))?;
            if let Some(machine) = &machine
                && store.machine(machine).await?.is_none()
            {
                bail!("there is no machine `{machine}`: register it first");
            }
            let issued = Issued::new(&name, role, machine, &clock)?;
            let id = issued.record.id.clone();
            store.create_token(issued.record, &actor).await?;
            let Err(unshown) = show(issued.text.expose_secret()) else { return Ok(()) };
            let revoked = store.revoke_token(&id, &actor, clock.now()).await;
            Err(not_shown(&id, &unshown, revoked.map(drop).map_err(Into::into)))
        }
        TokenCommand::List => {
            let mut after = None;
            loop {
                let page = store.tokens(Page { after, limit: PAGE }).await?;
                let Some(last) = page.last() else { return Ok(()) };
                after = Some(last.id.clone());
                print_rows(&page.into_iter().map(TokenView::from).collect::<Vec<_>>())?;
            }
        }
        TokenCommand::Revoke { id } => {
            let id = id_of(&id)?;
            match store.revoke_token(&id, &actor, clock.now()).await? {
                Some(_) => print(&format!("revoked {id}\n")),
                None => bail!("there is no token `{id}`"),
            }
        }
    }
}

/// The id that is meant: it alone, or what begins as its token does, up to the whole of it. What is neither may be a secret, and is
/// not repeated.
fn id_of(given: &SecretString) -> anyhow::Result<String> {
    let id = Token::id_of(given.expose_secret().trim());
    let id = id.context("that is no token's id: it is the part between the first two underscores")?;
    Ok(id.to_owned())
}

/// Shows a token, once. Where nobody reads it any more that is a failure too: nobody would ever know it.
fn show(token: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{token}")?;
    out.flush()
}

/// What is told of a token that could not be shown, and was to be revoked for it.
fn not_shown(id: &str, why: &io::Error, revoked: anyhow::Result<()>) -> anyhow::Error {
    match revoked {
        Ok(()) => anyhow::anyhow!("the token cannot be shown ({why}), and is revoked"),
        Err(error) => error.context(format!(
            "the token cannot be shown ({why}), and was not revoked: `feedwright token revoke {id}` does that"
        )),
    }
}

fn refused(violations: &[Violation]) -> anyhow::Error {
    let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
    anyhow::anyhow!(lines.join("; "))
}

fn print_rows(tokens: &[TokenView]) -> anyhow::Result<()> {
    let row = |token: &TokenView| {
        let state = token.revoked_at.as_ref().map_or("valid".to_owned(), |at| format!("revoked {at}"));
        let machine = token.machine.as_deref().unwrap_or("-");
        let (role, id, made, name) = (token.role.0.as_str(), &token.id, &token.created_at, &token.name);
        format!("{id}  {role:<8}  {machine}  {made}  {state}  {name}\n")
    };
    print(&tokens.iter().map(row).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(token: Option<&str>, file: Option<&str>, environment: &[(&str, &str)]) -> Option<String> {
        let arguments = Arguments {
            server: None,
            token: token.map(SecretString::from),
            token_file: file.map(PathBuf::from),
            command: TokenCommand::List,
        };
        let of = |name: &str| environment.iter().find(|(set, _)| *set == name).map(|(_, value)| value.into());
        Some(match Given::of(&arguments, of).unwrap()? {
            Given::Token(token) => token.expose_secret().to_owned(),
            Given::File(file) => file.to_string_lossy().into_owned(),
        })
    }

    #[test]
    fn a_flag_goes_before_the_environment() {
        let both = [("FEEDWRIGHT_TOKEN", "of the environment"), ("FEEDWRIGHT_TOKEN_FILE", "its file")];
        assert_eq!(given(None, Some("file"), &both).as_deref(), Some("file"));
        assert_eq!(given(Some("token"), None, &both).as_deref(), Some("token"));
        assert_eq!(given(None, None, &both).as_deref(), Some("of the environment"));
        assert_eq!(given(None, None, &both[1..]).as_deref(), Some("its file"));
        assert_eq!(given(None, None, &[("FEEDWRIGHT_TOKEN", "")]), None);
    }
}
