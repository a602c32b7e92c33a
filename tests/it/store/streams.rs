//! Leases on streams, and the overrides of a streamed cycle.

use super::given::{Given, at, shop, stories};
use feedwright_core::ids::MachineId;
use feedwright_store::{
    AlarmFilter, AlarmKind, CycleOverrides, LONGEST_LEASE_MS, Page, PostgresStore, Sent, Store, StreamLease,
    codec,
};
use std::sync::Arc;
use std::time::Duration;

stories!(
    one_holds_a_machines_stream,
    ones_own_lease_never_ends_sooner_for_being_taken_again,
    a_lease_that_no_stream_needs_is_not_prolonged_with_others,
    what_a_clock_that_was_ahead_has_leased_ends_as_the_longest_lease_does,
    overrides_are_kept_beside_the_cycle,
    an_overload_is_raised_once
);

fn machine() -> MachineId {
    "M1".try_into().unwrap()
}

const fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

async fn one_holds_a_machines_stream(store: Arc<dyn Store>) {
    let m = machine();
    let of_m = std::slice::from_ref(&m);
    let take =
        |holder, takeover, now, lease| store.take_stream(&m, holder, takeover, seconds(lease), at(now));
    assert_eq!(take("a", false, 0, 10).await.unwrap(), StreamLease::Taken { generation: 1 });
    assert_eq!(take("b", false, 5, 10).await.unwrap(), StreamLease::Held { wait: seconds(5) });
    assert_eq!(take("a", false, 6, 6).await.unwrap(), StreamLease::Taken { generation: 2 }, "its own");
    assert_eq!(store.renew_streams("a", of_m, seconds(13), at(7)).await.unwrap(), [(m.clone(), 2)]);
    assert_eq!(take("b", false, 19, 11).await.unwrap(), StreamLease::Held { wait: seconds(1) });
    assert_eq!(take("b", false, 20, 10).await.unwrap(), StreamLease::Taken { generation: 3 }, "expired");
    assert_eq!(store.renew_streams("a", of_m, seconds(19), at(21)).await.unwrap(), []);
    assert_eq!(take("a", true, 22, 18).await.unwrap(), StreamLease::Taken { generation: 4 }, "taken over");
    // What is not one's own any more is not given back; what is, is free at once.
    store.release_stream(&m, "b", 3).await.unwrap();
    assert_eq!(take("b", false, 24, 16).await.unwrap(), StreamLease::Held { wait: seconds(16) });
    store.release_stream(&m, "a", 4).await.unwrap();
    assert_eq!(take("b", false, 25, 25).await.unwrap(), StreamLease::Taken { generation: 5 });
    // It ended while its server could not ask, and nobody has come.
    assert_eq!(store.renew_streams("b", of_m, seconds(10), at(60)).await.unwrap(), [(m.clone(), 5)]);
    // Another has come and gone.
    assert_eq!(take("a", false, 80, 10).await.unwrap(), StreamLease::Taken { generation: 6 });
    store.release_stream(&m, "a", 6).await.unwrap();
    assert_eq!(store.renew_streams("b", of_m, seconds(10), at(81)).await.unwrap(), []);
    assert_eq!(store.renew_streams("a", of_m, seconds(10), at(81)).await.unwrap(), [], "it was given back");
}

/// Whoever is connected believes in the lease until then, whatever else is asked in its server's name.
async fn ones_own_lease_never_ends_sooner_for_being_taken_again(store: Arc<dyn Store>) {
    let m = machine();
    let take =
        |holder, takeover, now, lease| store.take_stream(&m, holder, takeover, seconds(lease), at(now));
    assert_eq!(take("a", false, 0, 10).await.unwrap(), StreamLease::Taken { generation: 1 });
    assert_eq!(take("a", false, 5, 0).await.unwrap(), StreamLease::Taken { generation: 2 });
    assert_eq!(take("b", false, 9, 10).await.unwrap(), StreamLease::Held { wait: seconds(1) });
    // Another's is not kept.
    assert_eq!(take("b", true, 9, 0).await.unwrap(), StreamLease::Taken { generation: 3 });
    assert_eq!(take("a", false, 9, 10).await.unwrap(), StreamLease::Taken { generation: 4 });
}

/// As of a connection that broke off before it was a stream: nobody would ever give it back.
async fn a_lease_that_no_stream_needs_is_not_prolonged_with_others(store: Arc<dyn Store>) {
    let (m, other) = (machine(), MachineId::try_from("M2").unwrap());
    for machine in [&m, &other] {
        let taken = store.take_stream(machine, "a", false, seconds(10), at(0)).await.unwrap();
        assert_eq!(taken, StreamLease::Taken { generation: 1 });
    }
    let renewed = store.renew_streams("a", std::slice::from_ref(&other), seconds(10), at(5)).await.unwrap();
    assert_eq!(renewed, [(other.clone(), 1)]);
    let take = |machine| store.take_stream(machine, "b", false, seconds(10), at(10));
    assert_eq!(take(&m).await.unwrap(), StreamLease::Taken { generation: 2 });
    assert_eq!(take(&other).await.unwrap(), StreamLease::Held { wait: seconds(5) });
}

async fn what_a_clock_that_was_ahead_has_leased_ends_as_the_longest_lease_does(store: Arc<dyn Store>) {
    let m = machine();
    let longest = LONGEST_LEASE_MS / 1000;
    let take = |holder, now, lease| store.take_stream(&m, holder, false, seconds(lease), at(now));
    assert_eq!(take("a", 40 * 86_400, 10).await.unwrap(), StreamLease::Taken { generation: 1 });
    // The clock is right again, and whoever held it is gone.
    assert_eq!(take("b", 0, 10).await.unwrap(), StreamLease::Held { wait: seconds(longest) });
    assert_eq!(take("b", 100, 10).await.unwrap(), StreamLease::Held { wait: seconds(longest - 100) });
    assert_eq!(take("b", 600, 2 * longest).await.unwrap(), StreamLease::Taken { generation: 2 });
    assert_eq!(take("a", 600, 10).await.unwrap(), StreamLease::Held { wait: seconds(longest) }, "no longer");
}

/// The clocks of two servers tell what they like: the database's counts.
#[tokio::test]
async fn servers_whose_clocks_are_apart_agree_on_who_holds_a_stream() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let m = machine();
    let (here, there) = (given.server_of_its_own().await, given.server_of_its_own().await);
    let take = |store: &PostgresStore, holder: &'static str, now| {
        let (store, m) = (store.clone(), m.clone());
        async move { store.take_stream(&m, holder, false, seconds(60), at(now)).await.unwrap() }
    };
    let renew = |store: &PostgresStore, holder: &'static str, now| {
        let (store, m) = (store.clone(), m.clone());
        async move {
            let renewed = store.renew_streams(holder, std::slice::from_ref(&m), seconds(60), at(now)).await;
            renewed.unwrap().into_iter().map(|(_, generation)| generation).collect::<Vec<_>>()
        }
    };
    let mut generation = 0;
    // The first holder is behind, ahead, and years ahead of the other one.
    for (first, second) in [(0, 150), (150, 0), (10 * 366 * 86_400, 0)] {
        generation += 1;
        assert_eq!(take(&here, "here", first).await, StreamLease::Taken { generation });
        let StreamLease::Held { wait } = take(&there, "there", second).await else {
            panic!("two hold it, {first} and {second}")
        };
        assert!(wait > Duration::ZERO && wait <= seconds(60), "{wait:?}");
        assert!(renew(&there, "there", second).await.is_empty());
        assert_eq!(renew(&here, "here", first).await, [generation]);
        let left = given
            .numbers(
                "SELECT expires_at_us - CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT)
                 FROM stream_leases",
            )
            .await;
        assert!(left[0] > 0 && left[0] <= 60_000_000, "{left:?}");

        // A minute goes by, in which the holder was not heard of.
        given.raw("UPDATE stream_leases SET expires_at_us = expires_at_us - 60000000").await.unwrap();
        generation += 1;
        assert_eq!(take(&there, "there", second).await, StreamLease::Taken { generation });
        assert!(renew(&here, "here", first).await.is_empty(), "it is told that it lost it");
        assert!(matches!(take(&here, "here", first).await, StreamLease::Held { .. }));
        there.release_stream(&m, "there", generation).await.unwrap();
    }
    for store in [here, there] {
        store.close().await;
    }
    given.done().await;
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
        store.put_overrides(&kept(percent), Sent::AsItRan).await.unwrap();
        let found = store.overrides(&m, &cycle).await.unwrap().unwrap();
        assert_eq!(found, kept(percent), "another one of its id was refused");
        assert_eq!(codec::decode_overrides(&found.block).unwrap(), [(percent, 1), (percent, 2)]);
    }
    // The machine has not heard that the cycle is being stored, and sends it again: too late for every sample.
    store.put_overrides(&kept(100.0), Sent::Again).await.unwrap();
    assert_eq!(store.overrides(&m, &cycle).await.unwrap().unwrap(), kept(103.5), "it was cut by these");
    // Of other samples than are there it is the only word.
    let longer = codec::encode_overrides(&[(100.0, 1), (100.0, 1), (100.0, 1)]).unwrap();
    let longer = CycleOverrides { block: longer, ..kept(100.0) };
    store.put_overrides(&longer, Sent::Again).await.unwrap();
    assert_eq!(store.overrides(&m, &cycle).await.unwrap().unwrap(), longer);
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
