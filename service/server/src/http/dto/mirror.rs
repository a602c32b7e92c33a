//! Bodies that mirror a value of the core field by field, written once.
//!
//! [`mirror!`] makes a body that is read and shown, [`shown!`] one that is only shown. What differs from the core by
//! more than names and types is written by hand beside them.

use feedwright_core::field_error::FieldError;
use feedwright_core::invalid::Violation;
use feedwright_core::plunge::PlungeLimit;
use feedwright_core::turning::{Binding, Limit};
use serde::Serialize;
use utoipa::ToSchema;

/// Turns one side of a mirror into the other.
pub trait To<T> {
    /// The other side.
    fn to(self) -> T;
}

macro_rules! same {
    ($($type:ty),*) => {$(
        impl To<$type> for $type {
            fn to(self) -> $type {
                self
            }
        }
    )*};
}

same!(f64, u32, u64, usize, bool, String, &'static str);

impl<A: To<B>, B> To<Option<B>> for Option<A> {
    fn to(self) -> Option<B> {
        self.map(To::to)
    }
}

impl<A: To<B>, B> To<Vec<B>> for Vec<A> {
    fn to(self) -> Vec<B> {
        self.into_iter().map(To::to).collect()
    }
}

macro_rules! word {
    ($($type:ty),*) => {$(
        impl To<&'static str> for $type {
            fn to(self) -> &'static str {
                self.as_str()
            }
        }
    )*};
}

word!(Limit, Binding, PlungeLimit);

/// A body that is read and shown: `Body = Core { field: type, … }`.
macro_rules! mirror {
    ($($(#[$outer:meta])* $body:ident = $core:ty { $($(#[$inner:meta])* $field:ident: $type:ty,)* })*) => {$(
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
        $(#[$outer])*
        #[serde(deny_unknown_fields)]
        pub struct $body {
            $($(#[$inner])* pub $field: $type,)*
        }

        impl $crate::http::dto::mirror::To<$core> for $body {
            fn to(self) -> $core {
                type Core = $core;
                Core { $($field: $crate::http::dto::mirror::To::to(self.$field),)* }
            }
        }

        impl $crate::http::dto::mirror::To<$body> for $core {
            fn to(self) -> $body {
                $body { $($field: $crate::http::dto::mirror::To::to(self.$field),)* }
            }
        }
    )*};
}
pub(crate) use mirror;

/// A body that is only shown: `Body = Core { field: type, … }`.
macro_rules! shown {
    ($($(#[$outer:meta])* $body:ident = $core:ty { $($(#[$inner:meta])* $field:ident: $type:ty,)* })*) => {$(
        #[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
        $(#[$outer])*
        pub struct $body {
            $($(#[$inner])* pub $field: $type,)*
        }

        impl $crate::http::dto::mirror::To<$body> for $core {
            fn to(self) -> $body {
                $body { $($field: $crate::http::dto::mirror::To::to(self.$field),)* }
            }
        }
    )*};
}
pub(crate) use shown;

/// A refused field inside `parent` as the API tells it.
pub fn violation(parent: &str, error: FieldError) -> Violation {
    Violation::new(error.path_in(parent), error.code(), error.problem().to_string())
}

/// Something true about an answer that its reader has to know before using it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct WarningBody {
    /// Stable code.
    #[schema(example = "outside_fitted_ranges")]
    pub code: &'static str,
    /// A sentence for a person.
    pub message: String,
}

impl WarningBody {
    /// A warning.
    pub fn new(code: &'static str, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }
}
