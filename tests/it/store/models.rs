//! The model library, what operations say of their process, and what an edge has cut.

use super::given::{Given, Run, at, engineer, mounted, operation, shop, stories};
use feedwright_core::cycle::{Cycle, ReportedCut};
use feedwright_core::operation::Operation;
use feedwright_core::plunge::{DrillingLaw, Material, MaterialInput};
use feedwright_core::recommend::{EdgeHistory, Knowledge, RecommendSettings};
use feedwright_core::turning::{Accumulation, JobInput, TurningModel, TurningSetup};
use feedwright_core::units::Process;
use feedwright_store::{
    Committed, Model, ModelContent, ModelKind, NewCycle, Page, Precondition, PutOutcome, Store, StoreError,
};
use std::sync::Arc;

stories!(
    the_library_starts_with_the_papers_entry,
    entries_are_put_by_version_and_kinds_do_not_mix,
    an_edge_is_known_by_what_it_has_cut,
    an_edge_has_cut_what_its_operation_stated_then,
    what_was_kept_in_part_or_has_no_time_is_told_of_an_edge,
);

mod tables {
    super::stories!(with tables: what_was_set_up_for_another_process_is_no_turning);
    use super::what_was_set_up_for_another_process_is_no_turning;
}

const ALL: u32 = 10;

async fn the_library_starts_with_the_papers_entry(store: Arc<dyn Store>) {
    let all = store.models(ModelKind::Turning, Page { after: None, limit: ALL }).await.unwrap();
    assert_eq!(all.len(), 1);
    // The migration's text and the core's own entry are the same to the bit.
    assert_eq!(all[0].value.content, ModelContent::Turning(TurningModel::alaskari_oraby_2017()));
    assert_eq!((all[0].value.id.as_str(), all[0].version), ("alaskari-oraby-2017", 1));
    assert!(store.models(ModelKind::Plunge, Page { after: None, limit: ALL }).await.unwrap().is_empty());
}

fn material(id: &str, coefficient: f64) -> Model {
    let law = DrillingLaw { coefficient, diameter_exponent: 1.0, feed_exponent: 0.7, correction: 1.0 };
    let input = MaterialInput { name: "C45".to_owned(), thrust: law, torque: law };
    Model { id: id.try_into().unwrap(), content: ModelContent::Plunge(Material::new(input).unwrap()) }
}

async fn entries_are_put_by_version_and_kinds_do_not_mix(store: Arc<dyn Store>) {
    let put = async |coefficient, expects| {
        store.put_model(material("alaskari-oraby-2017", coefficient), expects, &engineer(), at(1)).await
    };
    assert_eq!(put(680.0 / 7.0, Precondition::Absent).await.unwrap(), PutOutcome::Created);
    assert_eq!(put(680.0 / 7.0, Precondition::Unstated).await.unwrap(), PutOutcome::Unchanged(1));
    let unnamed = put(700.0, Precondition::Unstated).await;
    assert!(matches!(unnamed, Err(StoreError::VersionRequired { current: 1 })), "{unnamed:?}");
    assert_eq!(put(700.0, Precondition::Version(1)).await.unwrap(), PutOutcome::Changed(2));
    let id = "alaskari-oraby-2017".try_into().unwrap();
    let found = store.model(ModelKind::Plunge, &id).await.unwrap().unwrap();
    assert_eq!((found.value, found.version), (material("alaskari-oraby-2017", 700.0), 2));
    assert_eq!(store.model(ModelKind::Turning, &id).await.unwrap().unwrap().version, 1);
    let audit = store.audit(Page { after: None, limit: ALL }).await.unwrap();
    assert_eq!(audit.iter().filter(|line| line.action == "model.put").count(), 2);
}

pub(super) fn turned() -> Operation {
    let JobInput { depth_mm, interval_min, limits, domain, .. } = JobInput::alaskari_oraby_2017();
    let setup = TurningSetup {
        model: "alaskari-oraby-2017".try_into().unwrap(),
        depth_mm,
        diameter_mm: Some(80.0),
        interval_min,
        limits,
        domain,
        accumulation: Accumulation::State,
        caution_sigmas: 1.5,
    };
    Operation { process: Process::Turning, turning: Some(setup), ..operation("O1") }
}

async fn an_edge_is_known_by_what_it_has_cut(store: Arc<dyn Store>) {
    shop(&*store).await;
    let put = store.put_operation(turned(), Precondition::Version(1), &engineer(), at(1)).await;
    assert_eq!(put.unwrap(), PutOutcome::Changed(2));
    let stored = store.operation(&turned().id).await.unwrap().unwrap();
    assert_eq!(stored.value, turned());
    for n in [2, 1] {
        let mut draft = Run { sampled: false, ..Run::nth(n) }.draft();
        draft.reported.cut = ReportedCut {
            cutting_speed_m_min: Some(100.0 + f64::from(n)),
            feed_mm_rev: Some(0.3),
            ..ReportedCut::default()
        };
        let new = super::given::new_cycle(Cycle::new(draft).unwrap());
        let settings = RecommendSettings::default();
        let again = store.commit_cycles(vec![new.clone(), new], at(9000), settings).await;
        assert!(matches!(again[..], [Ok(Committed::Stored(_)), Ok(Committed::Known(_))]), "{again:?}");
    }
    let cuts = async || match store.knowledge(&turned(), &"T1".try_into().unwrap()).await.unwrap() {
        Knowledge::Turning { model: Some(_), history: EdgeHistory::Cycles(cycles) } => {
            cycles.iter().map(|cycle| cycle.speed_m_min).collect::<Vec<_>>()
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(cuts().await, [Some(101.0), Some(102.0)], "in the order in which they were run");
    // A new edge has cut nothing of it.
    mounted(&*store, "T1", 120).await;
    assert_eq!(cuts().await, [Some(102.0)]);
    let none = store.knowledge(&operation("O9"), &"T1".try_into().unwrap()).await.unwrap();
    assert_eq!(none, Knowledge::None);
}

async fn known(store: &dyn Store) -> EdgeHistory {
    match store.knowledge(&turned(), &"T1".try_into().unwrap()).await.unwrap() {
        Knowledge::Turning { history, .. } => history,
        other => panic!("{other:?}"),
    }
}

async fn stored(store: &dyn Store, new: NewCycle) {
    let outcome = store.commit_cycles(vec![new], at(9000), RecommendSettings::default()).await;
    assert!(matches!(outcome[..], [Ok(Committed::Stored(_))]), "{outcome:?}");
}

async fn an_edge_has_cut_what_its_operation_stated_then(store: Arc<dyn Store>) {
    shop(&*store).await;
    mounted(&*store, "T1", 30).await;
    let stating = |depth_mm, diameter_mm| {
        let setup = turned().turning.map(|setup| TurningSetup { depth_mm, diameter_mm, ..setup });
        Operation { turning: setup, ..turned() }
    };
    let put = async |operation, version, seconds| {
        let put =
            store.put_operation(operation, Precondition::Version(version), &engineer(), at(seconds)).await;
        assert_eq!(put.unwrap(), PutOutcome::Changed(version + 1));
    };
    put(stating(2.5, Some(80.0)), 1, 40).await;
    for n in [1, 2] {
        stored(&*store, Run { sampled: false, ..Run::nth(n) }.new_cycle()).await;
    }
    let cut = async || match known(&*store).await {
        EdgeHistory::Cycles(cycles) => cycles
            .into_iter()
            .map(|cycle| cycle.setup.map(|setup| (setup.depth_mm, setup.diameter_mm, setup.caution_sigmas)))
            .collect::<Vec<_>>(),
        other => panic!("{other:?}"),
    };
    let deep = Some((2.5, Some(80.0), 1.5));
    assert_eq!(cut().await, [deep, deep]);
    put(stating(1.5, Some(40.0)), 2, 150).await;
    assert_eq!(cut().await, [deep, deep], "what was cut stays cut so");
    // One that was run before the change comes after it.
    stored(&*store, Run { sampled: false, ..Run::nth(4) }.new_cycle()).await;
    stored(&*store, Run { sampled: false, seconds: 149, ..Run::nth(3) }.new_cycle()).await;
    assert_eq!(cut().await, [deep, deep, deep, Some((1.5, Some(40.0), 1.5))]);
    // What may have been declared too small is mended by what is larger, and what is none of the cut's geometry for all of it.
    put(stating(2.5, Some(80.0)), 3, 250).await;
    assert_eq!(cut().await, [deep; 4]);
    let other_limits = |setup: TurningSetup| TurningSetup { caution_sigmas: 2.0, ..setup };
    let mended = stating(2.5, Some(80.0));
    put(Operation { turning: mended.turning.clone().map(other_limits), ..mended }, 4, 260).await;
    let mended = deep.map(|(depth, diameter, _)| (depth, diameter, 2.0));
    assert_eq!(cut().await, [mended; 4]);
}

/// As after the migration that notes what is set up: there it is of whichever process.
async fn what_was_set_up_for_another_process_is_no_turning(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let plunge = "INSERT INTO operation_setups (operation_id, from_us, setup)
                  VALUES ('O1', -9000000000000000000, '{}')";
    given.raw(plunge).await.unwrap();
    store.put_operation(turned(), Precondition::Version(1), &engineer(), at(1)).await.unwrap();
    assert_eq!(given.numbers("SELECT COUNT(*) FROM operation_setups").await, [1]);
    stored(&*store, Run { sampled: false, ..Run::nth(1) }.new_cycle()).await;
    let EdgeHistory::Cycles(cycles) = known(&*store).await else { panic!("an edge that has cut") };
    let depth = turned().turning.map(|setup| setup.depth_mm);
    assert_eq!(cycles[0].setup.as_ref().map(|setup| setup.depth_mm), depth);
}

async fn what_was_kept_in_part_or_has_no_time_is_told_of_an_edge(store: Arc<dyn Store>) {
    shop(&*store).await;
    let put = store.put_operation(turned(), Precondition::Version(1), &engineer(), at(1)).await;
    assert_eq!(put.unwrap(), PutOutcome::Changed(2));
    // 1999-01-01, and when it came.
    let untimed = |n: u32, came: i64| {
        let seconds = 915_148_800 - at(0).micros() / 1_000_000 + i64::from(n);
        NewCycle { received_at: at(came), ..Run { seconds, ..Run::nth(n) }.new_cycle() }
    };
    stored(&*store, untimed(90, 50)).await;
    mounted(&*store, "T1", 60).await;
    let mut draft = Run::nth(2).draft();
    draft.reported.duration_ms = Some(60_000.0);
    stored(&*store, super::given::new_cycle(Cycle::new(draft).unwrap())).await;
    stored(&*store, NewCycle { cut_short: true, ..Run::nth(3).new_cycle() }).await;
    let EdgeHistory::Cycles(cycles) = known(&*store).await else {
        panic!("what came before the edge is not its own")
    };
    let told: Vec<_> = cycles
        .iter()
        .map(|cycle| (cycle.duration_ms, cycle.reported_duration_ms, cycle.sample_count, cycle.cut_short))
        .collect();
    assert_eq!(
        told,
        [(Some(2000.0), Some(60_000.0), 20, false), (Some(2000.0), None, 20, true)],
        "both lengths are told, and what was kept in part"
    );
    assert!((cycles[0].coverage - 1.0).abs() < 1e-12);
    stored(&*store, untimed(91, 300)).await;
    assert_eq!(known(&*store).await, EdgeHistory::Untimed);
    // The next edge has cut none of it.
    mounted(&*store, "T1", 400).await;
    assert_eq!(known(&*store).await, EdgeHistory::Cycles(Vec::new()));
}
