//! Numbers that are not below zero, told as what holds them.
//!
//! Those of 32 bits are described as integers with a sign of as many bits, which half of them do not fit: who generates a client would be told to
//! overflow.

use utoipa::Number;
use utoipa::openapi::path::Operation;
use utoipa::openapi::schema::{AdditionalProperties, ArrayItems, KnownFormat, Object, SchemaFormat};
use utoipa::openapi::{RefOr, Schema};

/// Of whatever an operation takes and answers, but for the types that have a name.
pub(super) fn hold_those_of(operation: &mut Operation) {
    let parameters = operation.parameters.iter_mut().flatten().filter_map(said_here);
    parameters.filter_map(|parameter| parameter.schema.as_mut()).for_each(hold);
    let taken = operation.request_body.iter_mut().filter_map(said_here);
    let taken = taken.flat_map(|body| body.content.values_mut());
    let answers = operation.responses.responses.values_mut().filter_map(said_here);
    let contents = taken.chain(answers.flat_map(|answer| answer.content.values_mut()));
    contents.filter_map(said_here).filter_map(|content| content.schema.as_mut()).for_each(hold);
}

/// What is said where it stands, and not by its name.
const fn said_here<T>(part: &mut RefOr<T>) -> Option<&mut T> {
    match part {
        RefOr::T(part) => Some(part),
        RefOr::Ref(_) => None,
    }
}

/// Of a type, and what it is made of.
pub(crate) fn hold(schema: &mut RefOr<Schema>) {
    let Some(schema) = said_here(schema) else { return };
    match schema {
        Schema::Object(object) => {
            if is_too_narrow(object) {
                object.format = Some(SchemaFormat::KnownFormat(KnownFormat::Int64));
            }
            object.properties.values_mut().for_each(hold);
            if let Some(AdditionalProperties::RefOr(others)) = object.additional_properties.as_deref_mut() {
                hold(others);
            }
        }
        Schema::Array(array) => {
            if let ArrayItems::RefOrSchema(item) = &mut array.items {
                hold(item);
            }
        }
        Schema::OneOf(parts) => parts.items.iter_mut().for_each(hold),
        Schema::AllOf(parts) => parts.items.iter_mut().for_each(hold),
        Schema::AnyOf(parts) => parts.items.iter_mut().for_each(hold),
        _ => {}
    }
}

fn is_too_narrow(number: &Object) -> bool {
    let fits = value(number.maximum.as_ref()).is_some_and(|most| most <= f64::from(i32::MAX));
    number.format == Some(SchemaFormat::KnownFormat(KnownFormat::Int32))
        && value(number.minimum.as_ref()).is_some_and(|least| least >= 0.0)
        && !fits
}

#[expect(clippy::cast_precision_loss, reason = "limits of numbers of 32 bits")]
fn value(limit: Option<&Number>) -> Option<f64> {
    limit.map(|limit| match limit {
        Number::Int(whole) => *whole as f64,
        Number::UInt(whole) => *whole as f64,
        Number::Float(number) => *number,
    })
}
