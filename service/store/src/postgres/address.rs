//! What an address of PostgreSQL may say behind its question mark.

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
