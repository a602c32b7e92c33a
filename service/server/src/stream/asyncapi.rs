//! The description of the stream for AsyncAPI 3.0, made from the types of its messages.

use super::answer::{
    ErrorMessage, GainMessage, OverrideMessage, PlainMessage, ResumedMessage, StartedMessage, StoredMessage,
};
use super::message::{
    EndMessage, HeartbeatMessage, MonitorMessage, ResumeMessage, SamplesSchema, StartMessage,
    VibrationMessage,
};
use crate::http::unsigned;
use serde_json::{Map, Value, json};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

struct Described {
    messages: Map<String, Value>,
    schemas: Map<String, Value>,
}

impl Described {
    fn add<T: ToSchema + PartialSchema>(&mut self, name: &str, summary: &str) {
        let mut nested: Vec<(String, RefOr<Schema>)> = Vec::new();
        T::schemas(&mut nested);
        nested.push((T::name().into_owned(), T::schema()));
        for (name, mut schema) in nested {
            unsigned::hold(&mut schema);
            self.schemas.insert(name, serde_json::to_value(schema).unwrap_or_default());
        }
        let payload = json!({"$ref": format!("#/components/schemas/{}", T::name())});
        let message = json!({
            "name": name, "summary": summary, "contentType": "application/json", "payload": payload
        });
        self.messages.insert(name.to_owned(), message);
    }

    fn binary(&mut self, name: &str, summary: &str) {
        let message = json!({
            "name": name, "summary": summary, "contentType": "application/octet-stream",
            "payload": {"type": "string", "format": "binary"}
        });
        self.messages.insert(name.to_owned(), message);
    }
}

/// The description as JSON, as it is checked in.
pub fn json() -> String {
    let mut out = serde_json::to_string_pretty(&describe()).unwrap_or_default();
    out.push('\n');
    out
}

fn describe() -> Value {
    let mut described = Described { messages: Map::new(), schemas: Map::new() };
    described.add::<StartMessage>("start", "Begins a cycle");
    described.add::<SamplesSchema>("samples", "Some samples in a row");
    described.add::<EndMessage>("end", "Ends a cycle");
    described.add::<ResumeMessage>("resume", "Goes on after the connection broke");
    described.add::<HeartbeatMessage>("heartbeat", "The machine lives");
    described.add::<MonitorMessage>("monitor", "Begins to watch a vibration");
    described.add::<VibrationMessage>("vibration", "A block of vibration");
    described.binary("samplesBinary", "Samples, first byte 0x01; docs/stream.md has the bytes");
    described.binary("vibrationBinary", "A block of vibration, first byte 0x02");
    let from_machine: Vec<String> = described.messages.keys().cloned().collect();
    described.add::<StartedMessage<'static>>("started", "A cycle has begun");
    described
        .add::<OverrideMessage<'static>>("override", "The answer to samples, and to a heartbeat in a cycle");
    described.add::<ResumedMessage<'static>>("resumed", "Where the cycle goes on");
    described.add::<StoredMessage>("stored", "The cycle is durably stored");
    described.add::<ErrorMessage<'static>>("error", "A message was refused or could not be read");
    described.add::<PlainMessage>("plain", "The answer to monitor, and to a heartbeat without a cycle");
    described.add::<GainMessage>("gain", "The answer to a block of vibration");
    described.binary("overrideBinary", "Overrides, first byte 0x81");
    described.binary("gainBinary", "The answer to a block of vibration, first byte 0x82");
    let to_machine = described.messages.keys().filter(|name| !from_machine.contains(name)).cloned();
    let refer = |name: String| json!({"$ref": format!("#/channels/stream/messages/{name}")});
    let to_machine: Vec<Value> = to_machine.map(refer).collect();
    let from_machine: Vec<Value> = from_machine.into_iter().map(refer).collect();
    let of_channel: Map<String, Value> = described
        .messages
        .keys()
        .map(|name| (name.clone(), json!({"$ref": format!("#/components/messages/{name}")})))
        .collect();
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "Feedwright stream", "version": "1",
            "description": "Samples of a running cycle in, feed overrides out; subprotocol feedwright.v1. An `integer` is written without a \
                fraction and without an exponent: `1.0` is refused."
        },
        "channels": {
            "stream": {
                "address": "/v1/machines/{machine}/stream",
                "parameters": {"machine": {"description": "The machine whose stream it is"}},
                "messages": of_channel,
                "bindings": {"ws": {"method": "GET"}}
            }
        },
        "operations": {
            "fromMachine": {"action": "receive", "channel": {"$ref": "#/channels/stream"}, "messages": from_machine},
            "toMachine": {"action": "send", "channel": {"$ref": "#/channels/stream"}, "messages": to_machine}
        },
        "components": {"messages": described.messages, "schemas": described.schemas}
    })
}
