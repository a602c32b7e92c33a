//! Leases on streams, and the overrides of a streamed cycle.

use super::given::{at, shop, stories};
use feedwright_core::ids::MachineId;
use feedwright_store::{AlarmFilter, AlarmKind, CycleOverrides, Page, Store, StreamLease, codec};
use std::sync::Arc;

stories!(one_holds_a_machines_stream, overrides_are_kept_beside_the_cycle, an_overload_is_raised_once);

fn machine() -> MachineId {
    "M1".try_into().unwrap()
}

async fn one_holds_a_machines_stream(store: Arc<dyn Store>) {
    let m = machine();
    let take = |holder, takeover, now, until| store.take_stream(&m, holder, takeover, at(now), at(until));
    assert_eq!(take("a", false, 0, 10).await.unwrap(), StreamLease::Taken { generation: 1 });
    assert_eq!(take("b", false, 5, 15).await.unwrap(), StreamLease::Held { until: at(10) });
    assert_eq!(take("a", false, 6, 12).await.unwrap(), StreamLease::Taken { generation: 2 }, "its own");
    assert_eq!(store.renew_streams("a", at(7), at(20)).await.unwrap(), [(m.clone(), 2)]);
    assert_eq!(take("b", false, 19, 30).await.unwrap(), StreamLease::Held { until: at(20) });
    assert_eq!(take("b", false, 20, 30).await.unwrap(), StreamLease::Taken { generation: 3 }, "expired");
    assert_eq!(store.renew_streams("a", at(21), at(40)).await.unwrap(), []);
    assert_eq!(take("a", true, 22, 40).await.unwrap(), StreamLease::Taken { generation: 4 }, "taken over");
    // What is not one's own any more is not given back; what is, is free at once.
    store.release_stream(&m, "b", 3, at(23)).await.unwrap();
    assert_eq!(take("b", false, 24, 40).await.unwrap(), StreamLease::Held { until: at(40) });
    store.release_stream(&m, "a", 4, at(25)).await.unwrap();
    assert_eq!(take("b", false, 25, 50).await.unwrap(), StreamLease::Taken { generation: 5 });
    // An expired lease is not prolonged: another may have come and gone.
    assert_eq!(store.renew_streams("b", at(60), at(70)).await.unwrap(), []);
}

async fn overrides_are_kept_beside_the_cycle(store: Arc<dyn Store>) {
    let (m, cycle) = (machine(), "c1".try_into().unwrap());
    assert_eq!(store.overrides(&m, &cycle).await.unwrap(), None);
    let kept = |percent: f64| CycleOverrides {
        machine: m.clone(),
        cycle: cycle.clone(),
        mode: "shadow".to_owned(),
        law_version: "fac-1".to_owned(),
        program_hash: Some("0".repeat(64)),
        stored_at: at(1),
        block: codec::encode_overrides(&[(percent, 1), (percent, 2)]).unwrap(),
    };
    for percent in [100.0, 103.5] {
        store.put_overrides(&kept(percent)).await.unwrap();
        let found = store.overrides(&m, &cycle).await.unwrap().unwrap();
        assert_eq!(found, kept(percent), "sent again, the later answers stand");
        assert_eq!(codec::decode_overrides(&found.block).unwrap(), [(percent, 1), (percent, 2)]);
    }
}

async fn an_overload_is_raised_once(store: Arc<dyn Store>) {
    shop(&*store).await;
    let tool = "T1".try_into().unwrap();
    for message in ["first", "second"] {
        store.raise_overload(&machine(), &tool, message, at(1)).await.unwrap();
    }
    let filter = AlarmFilter { open: Some(true), machine: Some(machine()), tool: None };
    let open = store.alarms(&filter, Page { after: None, limit: 9 }).await.unwrap();
    assert_eq!(
        open.iter().map(|alarm| (alarm.kind, alarm.message.as_str())).collect::<Vec<_>>(),
        [(AlarmKind::Overload, "first")]
    );
}
