//! What an address of PostgreSQL may say behind its question mark.

/// Parameters that have an effect, by the names that sqlx 0.9 knows.
const KNOWN: [&str; 19] = [
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
    "",
];

/// The name of a parameter of an address that would have no effect: a mistyped `sslmode` would leave the connection as it is by
/// default, and a mistyped password would be written to the log with its value.
pub fn unknown_parameter(url: &str) -> Option<&str> {
    let (_, parameters) = url.split_once('?')?;
    let parameters = parameters.split('#').next().unwrap_or_default();
    let names = parameters.split('&').map(|one| one.split('=').next().unwrap_or_default());
    names.into_iter().find(|name| !KNOWN.contains(name) && !is_option(name))
}

/// `options[name]`, also where its brackets are escaped.
fn is_option(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    ["options[", "options%5b"].iter().any(|begins| name.starts_with(begins))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_without_effect_is_named_and_its_value_is_not() {
        for fine in [
            "postgres://fw:a@b/c",
            "postgres://b/c?sslmode=verify-full&sslrootcert=/etc/ca.pem",
            "postgres://b/c?options[search_path]=plant&options%5Bwork_mem%5D=8MB&application_name=x",
            "postgres://b/c?",
        ] {
            assert_eq!(unknown_parameter(fine), None, "{fine}");
        }
        assert_eq!(unknown_parameter("postgres://b/c?sslmode=require&passwd=secret"), Some("passwd"));
        assert_eq!(unknown_parameter("postgres://b/c?SSLMODE=require"), Some("SSLMODE"));
    }
}
