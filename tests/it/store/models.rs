//! The model library, what operations say of their process, and what an edge has cut.

use super::given::{Run, at, engineer, mounted, operation, shop, stories};
use feedwright_core::cycle::{Cycle, ReportedCut};
use feedwright_core::operation::Operation;
use feedwright_core::plunge::{DrillingLaw, Material, MaterialInput};
use feedwright_core::recommend::{EdgeHistory, Knowledge, RecommendSettings};
use feedwright_core::turning::{Accumulation, JobInput, TurningModel, TurningSetup};
use feedwright_core::units::Process;
use feedwright_store::{
    Committed, Model, ModelContent, ModelKind, Page, Precondition, PutOutcome, Store, StoreError,
};
use std::sync::Arc;

stories!(
    the_library_starts_with_the_papers_entry,
    entries_are_put_by_version_and_kinds_do_not_mix,
    an_edge_is_known_by_what_it_has_cut,
);

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

fn turned() -> Operation {
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
