//! The layers of the configuration: defaults, file, environment, flags.

use super::Config;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt;
use std::path::PathBuf;
use toml::{Table, Value};

const DEFAULTS: &str = include_str!("default.toml");
/// Begins the name of every environment variable that is a setting.
const PREFIX: &str = "FEEDWRIGHT__";
/// The settings that hold secrets.
const SECRETS: [&str; 4] = ["database.url", "database.direct_url", "traces.endpoint", "traces.headers"];

/// Where settings come from beside the defaults.
#[derive(Debug, Clone, Default)]
pub struct Sources {
    /// A TOML file.
    pub file: Option<PathBuf>,
    /// The environment; only names that begin with `FEEDWRIGHT__` are looked at.
    pub environment: Vec<(String, String)>,
    /// Flags: path of the setting and its value.
    pub flags: Vec<(String, String)>,
}

/// The variables that are settings. One that is no UTF-8 is refused by its name: left out, it would be as if it were not set, and a
/// default (another database than the plant's) in its place. Its value may be a secret.
pub(crate) fn settings_of(
    environment: impl Iterator<Item = (OsString, OsString)>,
) -> Result<Vec<(String, String)>, ConfigError> {
    let (mut settings, mut wrong) = (Vec::new(), Vec::new());
    for (name, value) in environment {
        if !name.as_encoded_bytes().starts_with(PREFIX.as_bytes()) {
            continue;
        }
        match (name.into_string(), value.into_string()) {
            (Ok(name), Ok(value)) => settings.push((name, value)),
            (Ok(name), Err(_)) => wrong.push(format!("{name}: its value is not UTF-8")),
            (Err(name), _) => wrong.push(format!("{}: its name is not UTF-8", name.to_string_lossy())),
        }
    }
    if wrong.is_empty() { Ok(settings) } else { Err(ConfigError::Invalid(wrong)) }
}

/// Where a value came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// The embedded defaults.
    Default,
    /// The file.
    File(PathBuf),
    /// This environment variable.
    Environment(String),
    /// A flag.
    Flag,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Environment(name) => f.write_str(name),
            Self::Flag => f.write_str("flag"),
        }
    }
}

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {why}")]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// Keys or values are not accepted; a line each, with the path.
    #[error("the configuration is not accepted:\n  {}", .0.join("\n  "))]
    Invalid(Vec<String>),
}

pub(super) fn merge(sources: &Sources) -> Result<Config, ConfigError> {
    let mut tree: Table =
        toml::from_str(DEFAULTS).map_err(|error| ConfigError::Invalid(vec![error.to_string()]))?;
    let mut origins = BTreeMap::new();
    let mut wrong = Vec::new();
    if let Some(path) = &sources.file {
        let file = read(path)?;
        overlay(&mut tree, &file, "", &Origin::File(path.clone()), &mut origins, &mut wrong);
    }
    for (name, value) in &sources.environment {
        if let Some(rest) = name.strip_prefix(PREFIX) {
            let path = rest.to_lowercase().replace("__", ".");
            let origin = Origin::Environment(name.clone());
            set(&mut tree, &path, value, origin, &mut origins, &mut wrong);
        }
    }
    for (path, value) in &sources.flags {
        set(&mut tree, path, value, Origin::Flag, &mut origins, &mut wrong);
    }
    if !wrong.is_empty() {
        return Err(ConfigError::Invalid(wrong));
    }
    let printed = print(&tree, &origins);
    let mut config: Config = serde_path_to_error::deserialize(Value::Table(tree)).map_err(|error| {
        let path = error.path().to_string();
        // The value itself is left out of the message where it is a secret.
        let why = if SECRETS.contains(&path.as_str()) {
            "not accepted".to_owned()
        } else {
            error.inner().message().to_owned()
        };
        let origin = origins.get(&path).unwrap_or(&Origin::Default);
        ConfigError::Invalid(vec![format!("{path}: {why} (from {origin})")])
    })?;
    config.printed = printed;
    Ok(config)
}

fn read(path: &PathBuf) -> Result<Table, ConfigError> {
    let unreadable = |why: String| ConfigError::Unreadable { path: path.clone(), why };
    let text = std::fs::read_to_string(path).map_err(|error| unreadable(error.to_string()))?;
    // The parser's own rendering quotes the line, which may hold a password.
    toml::from_str(&text).map_err(|error: toml::de::Error| {
        let line = error.span().map_or(1, |span| text[..span.start.min(text.len())].lines().count().max(1));
        unreadable(format!("line {line}: {}", error.message()))
    })
}

/// Lays `over` upon `tree`: a key that the tree lacks, or of another type than there, is refused by its path.
fn overlay(
    tree: &mut Table,
    over: &Table,
    prefix: &str,
    origin: &Origin,
    origins: &mut BTreeMap<String, Origin>,
    wrong: &mut Vec<String>,
) {
    for (key, value) in over {
        let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match (tree.get_mut(key), value) {
            (None, _) => wrong.push(format!("{path}: unknown key (from {origin})")),
            (Some(Value::Table(tree)), Value::Table(over)) => {
                overlay(tree, over, &path, origin, origins, wrong);
            }
            (Some(old), new) if old.same_type(new) => {
                *old = new.clone();
                origins.insert(path, origin.clone());
            }
            (Some(old), new) => wrong.push(format!(
                "{path}: must be of type {}, is of type {} (from {origin})",
                old.type_str(),
                new.type_str()
            )),
        }
    }
}

/// Sets one leaf from text, read as the type that the leaf has.
fn set(
    tree: &mut Table,
    path: &str,
    text: &str,
    origin: Origin,
    origins: &mut BTreeMap<String, Origin>,
    wrong: &mut Vec<String>,
) {
    let mut parts = path.split('.');
    let first = parts.next().and_then(|part| tree.get_mut(part));
    let leaf = parts.fold(first, |at, part| at.and_then(|value| value.as_table_mut()?.get_mut(part)));
    let parsed = match leaf.as_deref() {
        None | Some(Value::Table(_)) => Err("unknown key".to_owned()),
        Some(Value::Boolean(_)) => {
            text.parse().map(Value::Boolean).map_err(|_| "must be true or false".to_owned())
        }
        Some(Value::Integer(_)) => {
            text.parse().map(Value::Integer).map_err(|_| "must be a whole number".to_owned())
        }
        Some(Value::Float(_)) => text.parse().map(Value::Float).map_err(|_| "must be a number".to_owned()),
        Some(_) => Ok(Value::String(text.to_owned())),
    };
    match (leaf, parsed) {
        (Some(leaf), Ok(value)) => {
            *leaf = value;
            origins.insert(path.to_owned(), origin);
        }
        (_, Err(why)) => wrong.push(format!("{path}: {why} (from {origin})")),
        (None, Ok(_)) => wrong.push(format!("{path}: unknown key (from {origin})")),
    }
}

fn print(tree: &Table, origins: &BTreeMap<String, Origin>) -> BTreeMap<String, (String, Origin)> {
    let mut printed = BTreeMap::new();
    let mut leaf = |path: String, value: &Value| {
        let text = match value {
            Value::String(url) if SECRETS.contains(&path.as_str()) => {
                Value::String(without_password(url)).to_string()
            }
            other => other.to_string(),
        };
        let origin = origins.get(&path).cloned().unwrap_or(Origin::Default);
        printed.insert(path, (text, origin));
    };
    for (key, value) in tree {
        match value {
            Value::Table(section) => {
                for (inner, value) in section {
                    leaf(format!("{key}.{inner}"), value);
                }
            }
            value => leaf(key.clone(), value),
        }
    }
    printed
}

/// The address without user, password and parameters: all of them may hold secrets.
fn without_password(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else {
        return if url.is_empty() { String::new() } else { "(hidden)".to_owned() };
    };
    let place = rest.rsplit_once('@').map_or(rest, |(_, place)| place);
    let place = place.split(['?', '#']).next().unwrap_or_default();
    if place.len() == rest.len() { url.to_owned() } else { format!("{scheme}://(hidden)@{place}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use secrecy::ExposeSecret;

    fn load(environment: &[(&str, &str)], file: Option<&str>) -> Result<Config, String> {
        let dir = std::env::temp_dir().join(format!("feedwright-config-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir_all(&dir).unwrap();
        let path = file.map(|text| {
            let path = dir.join("feedwright.toml");
            std::fs::write(&path, text).unwrap();
            path
        });
        let environment = environment.iter().map(|&(k, v)| (k.to_owned(), v.to_owned())).collect();
        let loaded = Config::load(&Sources { file: path, environment, flags: Vec::new() });
        std::fs::remove_dir_all(&dir).unwrap();
        loaded.map_err(|error| error.to_string())
    }

    #[test]
    fn defaults_are_accepted_and_stay_on_this_machine() {
        let config = load(&[], None).unwrap();
        assert!(config.server.listen.ip().is_loopback());
        assert_eq!(config.limits.samples_per_cycle, feedwright_core::cycle::DEFAULT_MAX_SAMPLES);
    }

    #[test]
    fn later_layers_win_and_say_so() {
        let file = "[server]\nmax_connections = 7\nheader_read_timeout_ms = 5\n";
        let config = load(&[("FEEDWRIGHT__SERVER__MAX_CONNECTIONS", "9")], Some(file)).unwrap();
        assert_eq!((config.server.max_connections, config.server.header_read_timeout_ms), (9, 5));
        let print = config.print();
        assert!(
            print.contains("server.max_connections = 9  # FEEDWRIGHT__SERVER__MAX_CONNECTIONS"),
            "{print}"
        );
        assert!(print.contains("log.level = \"info\"  # default"), "{print}");
    }

    #[test]
    fn a_variable_that_is_no_utf_8_is_refused_by_its_name_and_one_of_others_is_left_alone() {
        use std::os::unix::ffi::OsStringExt;
        let of = |name: &[u8], value: &[u8]| {
            (OsString::from_vec(name.to_vec()), OsString::from_vec(value.to_vec()))
        };
        let others = [of(b"PATH", b"/b\xffn"), of(b"F\xff", b"x")];
        let good = of(b"FEEDWRIGHT__LOG__LEVEL", b"warn");
        let settings = settings_of(others.iter().cloned().chain([good])).unwrap();
        assert_eq!(settings, [("FEEDWRIGHT__LOG__LEVEL".to_owned(), "warn".to_owned())]);
        for (name, value, said) in [
            (
                &b"FEEDWRIGHT__DATABASE__URL"[..],
                &b"postgres://fw:hunter\xff@x/y"[..],
                "FEEDWRIGHT__DATABASE__URL: its value is not UTF-8",
            ),
            (b"FEEDWRIGHT__DATABASE__\xff", b"x", "its name is not UTF-8"),
        ] {
            let error = settings_of([of(name, value)].into_iter()).unwrap_err().to_string();
            assert!(error.contains(said) && !error.contains("hunter"), "{error}");
        }
    }

    #[test]
    fn unknown_keys_are_refused_by_their_path() {
        for (environment, file, path) in [
            (vec![("FEEDWRIGHT__SERVER__LISTEN_ON", "x")], None, "server.listen_on: unknown key"),
            (vec![("FEEDWRIGHT__SERVER", "x")], None, "server: unknown key"),
            (vec![], Some("[limits]\nbodybytes = 3\n"), "limits.bodybytes: unknown key"),
            (vec![], Some("[limit]\nbody_bytes = 3\n"), "limit: unknown key"),
            (vec![], Some("[limits]\nbody_bytes = \"3\"\n"), "limits.body_bytes: must be of type integer"),
            (
                vec![("FEEDWRIGHT__LIMITS__BODY_BYTES", "many")],
                None,
                "limits.body_bytes: must be a whole number",
            ),
            (vec![("FEEDWRIGHT__LOG__FORMAT", "xml")], None, "log.format: unknown variant"),
            (vec![("FEEDWRIGHT__LOG__LEVEL", "")], None, "log.level: must be off"),
            (
                vec![("FEEDWRIGHT__TRACES__HEADERS", "bad header=1")],
                None,
                "traces.headers: must be name=value",
            ),
            (
                vec![("FEEDWRIGHT__TRACES__HEADERS", "a=b,c=d\u{1}e")],
                None,
                "traces.headers: must be name=value",
            ),
            (
                vec![("FEEDWRIGHT__STREAM__ALLOWED_ORIGINS", "https://a.example, https://b.example/")],
                None,
                "stream.allowed_origins: `https://b.example/` is not SCHEME://HOST or SCHEME://HOST:PORT",
            ),
            (
                vec![("FEEDWRIGHT__STREAM__ALLOWED_ORIGINS", "foo")],
                None,
                "stream.allowed_origins: `foo` is not",
            ),
            (vec![("FEEDWRIGHT__LIMITS__BODY_BYTES", "0")], None, "limits.body_bytes: 1 to"),
            (
                vec![("FEEDWRIGHT__RECOMMENDATION__VALIDITY_MS", "-5")],
                None,
                "recommendation.validity_ms: 1 to",
            ),
            (
                vec![("FEEDWRIGHT__WATCH__MACHINE_SILENT_AFTER_MS", "20000")],
                None,
                "watch.machine_silent_after_ms: 0, or 30000",
            ),
            (
                vec![("FEEDWRIGHT__WATCH__MACHINE_SILENT_AFTER_MS_BY_MACHINE", "M1=900000, M 2=0")],
                None,
                "watch.machine_silent_after_ms_by_machine: `M 2=0` is not MACHINE=MILLISECONDS",
            ),
            (vec![("FEEDWRIGHT__TLS__CERTIFICATE", "a.pem")], None, "tls.key: certificate and key belong"),
            (vec![("FEEDWRIGHT__TLS__KEY", "a.pem")], None, "tls.key: certificate and key belong"),
            (vec![("FEEDWRIGHT__DATABASE__URL", "mysql://x")], None, "database.url: must be empty or begin"),
            (
                vec![("FEEDWRIGHT__DATABASE__URL", "postgres://x/y?sslmod=require")],
                None,
                "database.url: has a parameter `sslmod` that is not known",
            ),
            (
                vec![
                    ("FEEDWRIGHT__DATABASE__URL", "postgres://x/y"),
                    ("FEEDWRIGHT__DATABASE__POOLED", "true"),
                ],
                None,
                "database.direct_url: name the server itself",
            ),
        ] {
            let error = load(&environment, file).unwrap_err();
            assert!(error.contains(path), "{error}");
        }
    }

    #[test]
    fn a_public_address_needs_the_explicit_flag() {
        for listen in ["0.0.0.0:7878", "[::]:7878", "192.168.1.5:80"] {
            let error = load(&[("FEEDWRIGHT__SERVER__LISTEN", listen)], None).unwrap_err();
            assert!(error.contains("server.allow_plain_http_on_public_address"), "{error}");
            let flag = ("FEEDWRIGHT__SERVER__ALLOW_PLAIN_HTTP_ON_PUBLIC_ADDRESS", "true");
            assert!(load(&[("FEEDWRIGHT__SERVER__LISTEN", listen), flag], None).is_ok());
            assert!(load(&[("FEEDWRIGHT__METRICS__LISTEN", listen)], None).is_err());
            let tls = [("FEEDWRIGHT__TLS__CERTIFICATE", "a.pem"), ("FEEDWRIGHT__TLS__KEY", "b.pem")];
            let with = |name| load(&[tls[0], tls[1], (name, listen)], None);
            assert!(with("FEEDWRIGHT__SERVER__LISTEN").is_ok());
            assert!(with("FEEDWRIGHT__METRICS__LISTEN").is_err(), "its listener is plain");
        }
    }

    #[test]
    fn a_password_is_never_printed() {
        let url = "postgres://fw:hunt@er2@db.example/fw?password=hunter3";
        let headers = ("FEEDWRIGHT__TRACES__HEADERS", "authorization=Bearer hunter4");
        let config = load(&[("FEEDWRIGHT__DATABASE__URL", url), headers], None).unwrap();
        assert_eq!(config.database.url.expose_secret(), url);
        for text in [config.print(), format!("{config:?}")] {
            assert!(!text.contains("hunt") && !text.contains("er2"), "{text}");
        }
        assert!(config.print().contains("postgres://(hidden)@db.example/fw"));
        let error = load(&[], Some("[database]\nurl = \"postgres://fw:hunter2@x\nb = 1")).unwrap_err();
        assert!(!error.contains("hunter2"), "{error}");
    }
}
