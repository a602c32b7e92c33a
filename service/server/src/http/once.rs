//! Headers that have one value. Where one stands there twice, whoever looks at the request on its way, such as a proxy, may go by
//! another line than this server: so neither is believed.

use http::header::AsHeaderName;
use http::{HeaderMap, HeaderValue};

/// A header that has one value stands there more than once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Repeated;

/// The value of such a header; `None` where it is not there.
///
/// # Errors
/// [`Repeated`], also where all lines say the same.
pub(crate) fn once(headers: &HeaderMap, name: impl AsHeaderName) -> Result<Option<&HeaderValue>, Repeated> {
    let mut lines = headers.get_all(name).iter();
    match (lines.next(), lines.next()) {
        (one, None) => Ok(one),
        (_, Some(_)) => Err(Repeated),
    }
}
