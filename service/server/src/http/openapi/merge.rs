//! Types that are written into each other, as one object.
//!
//! What Serde flattens is described as an `allOf` of its parts. Where a part takes no other fields than its own, nothing
//! satisfies that, since every part would have to be the whole.

use std::collections::BTreeMap;
use utoipa::openapi::schema::{AdditionalProperties, AllOf, ArrayItems, Object};
use utoipa::openapi::{RefOr, Schema};

type Schemas = BTreeMap<String, RefOr<Schema>>;

/// Makes one object of every `allOf` that has a closed part; of the others too where all parts are objects.
pub(super) fn merge(schemas: &mut Schemas) {
    let known = schemas.clone();
    for schema in schemas.values_mut() {
        whole(schema, &known);
    }
}

fn whole(schema: &mut RefOr<Schema>, known: &Schemas) {
    let RefOr::T(schema) = schema else { return };
    if let Schema::AllOf(parts) = schema
        && let Some(object) = object(parts, known)
    {
        *schema = Schema::Object(object);
    }
    match schema {
        Schema::Object(object) => object.properties.values_mut().for_each(|field| whole(field, known)),
        Schema::Array(array) => {
            if let ArrayItems::RefOrSchema(item) = &mut array.items {
                whole(item, known);
            }
        }
        _ => {}
    }
}

/// One object with the fields of all parts; `None` where one of them is no object.
fn object(parts: &AllOf, known: &Schemas) -> Option<Object> {
    let mut merged: Option<Object> = None;
    let mut closed = false;
    for part in &parts.items {
        let part = resolved(part, known)?;
        closed |=
            matches!(part.additional_properties.as_deref(), Some(AdditionalProperties::FreeForm(false)));
        match &mut merged {
            None => merged = Some(part),
            Some(whole) => {
                whole.properties.extend(part.properties);
                whole.required.extend(part.required);
            }
        }
    }
    let mut merged = merged?;
    merged.additional_properties = closed.then(|| Box::new(AdditionalProperties::FreeForm(false)));
    merged.description = parts.description.clone().or(merged.description);
    // It would lack the fields of the other parts.
    merged.example = None;
    merged.examples.clear();
    Some(merged)
}

fn resolved(part: &RefOr<Schema>, known: &Schemas) -> Option<Object> {
    match part {
        RefOr::T(Schema::Object(object)) => Some(object.clone()),
        RefOr::T(Schema::AllOf(parts)) => object(parts, known),
        RefOr::Ref(named) => {
            let name = named.ref_location.strip_prefix("#/components/schemas/")?;
            resolved(known.get(name)?, known)
        }
        RefOr::T(_) => None,
    }
}
