//! What an address of PostgreSQL may say behind its question mark.

use std::fs::File;

/// Parameters that have an effect, by the names that sqlx 0.9 knows.
const KNOWN: [&str; 18] = [
    "application_name",
    "dbname",
    "host",
    "hostaddr",
    "options",
    "password",
    "port",
    "ssl-ca",
    "ssl-cert",
    "ssl-key",
    "ssl-mode",
    "ssl-root-cert",
    "sslcert",
    "sslkey",
    "sslmode",
    "sslrootcert",
    "statement-cache-capacity",
    "user",
];
/// Those of libpq that hosts hand out with their addresses, that sqlx leaves out of account, and that nothing here rests on.
const LEFT_OUT: [&str; 7] = [
    "channel_binding",
    "connect_timeout",
    "gssencmode",
    "keepalives",
    "keepalives_idle",
    "sslnegotiation",
    "target_session_attrs",
];
/// Longest name that is told.
const MOST_NAME: usize = 32;

/// Why an address is not taken, if one of its parameters would have no effect: a mistyped `sslmode` would leave the connection as it
/// is by default, and a mistyped `password` would be written to the log with its value.
///
/// A name is told only where it can be one: `?` and `&` of a password that are not escaped make parameters of its parts.
pub fn unknown_parameter(url: &str) -> Option<String> {
    let (_, parameters) = url.split_once('?')?;
    let is_whole = !parameters.contains('@');
    let parameters = parameters.split('#').next().unwrap_or_default();
    let unknown = parameters.split('&').filter(|one| !one.is_empty()).find(|one| {
        let name = unescaped(one.split('=').next().unwrap_or_default());
        !KNOWN.contains(&name.as_str()) && !LEFT_OUT.contains(&name.as_str()) && !is_option(&name)
    })?;
    let named = unknown.split_once('=').map(|(name, _)| name).filter(|name| {
        let may_be = |byte: u8| byte.is_ascii_alphabetic() || matches!(byte, b'_' | b'-');
        is_whole && name.len() <= MOST_NAME && name.bytes().all(may_be)
    });
    Some(match named {
        Some(name) => format!("has a parameter `{name}` that is not known"),
        None => "has a parameter that is not known, or a `?` or `&` that is to be written as %3F or %26"
            .to_owned(),
    })
}

/// Parameters that name a file.
const FILES: [&str; 7] =
    ["ssl-ca", "ssl-cert", "ssl-key", "ssl-root-cert", "sslcert", "sslkey", "sslrootcert"];

/// Why a file that an address names cannot be read, if one cannot: whoever connects is told what is wrong, and not of which file.
pub(super) fn unreadable_file(url: &str) -> Option<String> {
    let (_, parameters) = url.split_once('?')?;
    let named = parameters.split('#').next()?.split('&').filter_map(|one| one.split_once('='));
    named
        .filter_map(|(name, path)| Some((FILES.iter().find(|file| **file == unescaped(name))?, path)))
        .find_map(|(name, path)| {
            // The text itself, or escaped, which who connects knows to read.
            if path.starts_with("-----") || path.contains('%') {
                return None;
            }
            let error = File::open(path).err()?;
            Some(format!("`{name}` names {path}, which cannot be read: {error}"))
        })
}

/// As names may be escaped that are known.
fn unescaped(name: &str) -> String {
    [
        ("%5B", "["),
        ("%5b", "["),
        ("%5D", "]"),
        ("%5d", "]"),
        ("%2D", "-"),
        ("%2d", "-"),
        ("%5F", "_"),
        ("%5f", "_"),
    ]
    .iter()
    .fold(name.to_owned(), |name, (escaped, plain)| name.replace(escaped, plain))
}

fn is_option(name: &str) -> bool {
    name.starts_with("options[") && name.ends_with(']')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_cannot_be_read_is_named() {
        for fine in [
            "postgres://b/c",
            "postgres://b/c?sslmode=require",
            "postgres://b/c?sslrootcert=/dev/null&sslkey=%2Fnowhere",
            "postgres://b/c?sslcert=-----BEGIN CERTIFICATE-----",
        ] {
            assert_eq!(unreadable_file(fine), None, "{fine}");
        }
        for (name, told) in [("sslrootcert", "sslrootcert"), ("ssl%2Dkey", "ssl-key")] {
            let why =
                unreadable_file(&format!("postgres://u:p@b/c?sslmode=verify-full&{name}=/nowhere/ca.pem"));
            let why = why.unwrap();
            assert!(
                why.starts_with(&format!("`{told}` names /nowhere/ca.pem, which cannot be read: ")),
                "{why}"
            );
        }
    }

    #[test]
    fn a_parameter_without_effect_is_named_and_nothing_that_may_be_secret() {
        for fine in [
            "postgres://fw:a@b/c",
            "postgres://b/c?sslmode=verify-full&sslrootcert=/etc/ca.pem&ssl%2Dmode=require",
            "postgres://b/c?options[search_path]=plant&options%5Bwork_mem%5D=8MB&application_name=x",
            "postgres://b/c?sslmode=require&channel_binding=require",
            "postgres://b/c?",
        ] {
            assert_eq!(unknown_parameter(fine), None, "{fine}");
        }
        for (address, name) in [
            ("postgres://b/c?sslmode=require&passwd=secret", "passwd"),
            ("postgres://b/c?SSLMODE=require", "SSLMODE"),
        ] {
            let told = unknown_parameter(address).unwrap();
            assert!(told.contains(&format!("`{name}`")), "{told}");
        }
        for address in [
            "postgres://fw:hun?ter2@db/fw",
            "postgres://fw:hun?ter2=@db/fw",
            "postgres://db/fw?user=fw&password=ab&cd9secret",
            "postgres://db/fw?OPTIONS[search_path]=x",
            "postgres://db/fw?options[search_path=x",
        ] {
            let told = unknown_parameter(address).unwrap();
            assert!(["ter2", "cd9", "search"].iter().all(|secret| !told.contains(secret)), "{told}");
        }
    }
}
