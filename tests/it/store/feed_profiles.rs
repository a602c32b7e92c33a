//! Feed profiles: kept once, moved one step at a time by whoever may, handed out only where they hold.

use super::given::{Run, at, engineer, machine, operation, shop, stored, stories, tool};
use feedwright_core::cycle::{Cycle, ProfileVersion};
use feedwright_core::feed::life_cycle::{Step, VersionState};
use feedwright_core::feed::profile::{
    Conditions, LimitsInput, Profile, ProfileInput, SectionInput, SectionKind, WearBandInput,
};
use feedwright_core::ids::ProfileId;
use feedwright_core::operation::Operation;
use feedwright_core::recommend::{RecommendSettings, Recommendation};
use feedwright_core::tool::Tool;
use feedwright_store::{
    ActiveProfiles, Actor, Committed, CycleFilter, FeedProfile, FeedProfileFilter, NewProfileVersion, Page,
    Precondition, ProfileMove, ProfileSource, Role, Store, StoreError, StoreResult, profile_hash,
};
use std::sync::Arc;

stories!(
    a_content_is_kept_once_under_one_line,
    a_version_goes_its_way_by_two_people_and_back_in_one_call,
    of_two_moves_at_once_exactly_one_wins,
    only_the_active_version_that_fits_is_handed_out,
    the_cycles_of_a_version_are_found,
    the_last_cycles_with_a_type_of_tool_are_found_whether_few_have_it_or_many,
);

fn approver() -> Actor {
    Actor { token: "tok-ada".to_owned(), role: Role::Approver }
}

pub(crate) fn id(text: &str) -> ProfileId {
    text.try_into().unwrap()
}

/// A profile of operation O1 and the story's tool; the feed at its end tells versions apart.
fn content(end_feed: f64, from_level: Option<f64>, to_level: f64) -> Profile {
    let of = operation("O1");
    Profile::new(ProfileInput {
        operation: of.id,
        tool_type: "friction-6".to_owned(),
        knots: [(0.0, 100.0), (2.0, 150.0), (4.75, end_feed)].map(Into::into).to_vec(),
        sections: vec![
            SectionInput { kind: SectionKind::Heating, to_mm: 2.0 },
            SectionInput { kind: SectionKind::Forming, to_mm: 4.75 },
        ],
        limits: LimitsInput {
            feed_min_mm_min: 50.0,
            feed_max_mm_min: 1000.0,
            acceleration_mm_s2: 300.0,
            override_min_percent: 20.0,
            override_max_percent: 150.0,
            spindle_load_set_percent: Some(35.5),
            feed_drive_load_set_percent: None,
        },
        wear: WearBandInput { from_level, to_level },
        conditions: Conditions {
            program: of.program,
            work_material: of.work_material,
            spindle_speed_rpm: of.spindle_speed_rpm,
        },
    })
    .unwrap()
}

pub(super) fn new(end_feed: f64) -> NewProfileVersion {
    NewProfileVersion {
        content: content(end_feed, None, 1.07),
        source: ProfileSource::Drawn,
        based_on: None,
        reason: "as the story goes".to_owned(),
        report: None,
    }
}

async fn draft(store: &dyn Store, line: &str, end_feed: f64) -> u32 {
    let drafted = store.draft_profile(&id(line), new(end_feed), &engineer(), at(1)).await.unwrap();
    assert!(drafted.is_new);
    drafted.version
}

async fn go(store: &dyn Store, step: Step, version: u32, who: &Actor) -> StoreResult<Option<FeedProfile>> {
    let line = store.feed_profile(&id("P1")).await.unwrap().unwrap();
    let expects = Precondition::Version(line.revision);
    store.move_profile(&id("P1"), ProfileMove::Step(step, version), expects, who, at(2)).await
}

/// Drafts and brings into force; returns its number.
pub(crate) async fn activated(store: &dyn Store, end_feed: f64) -> u32 {
    let version = draft(store, "P1", end_feed).await;
    go(store, Step::Shadow, version, &engineer()).await.unwrap();
    go(store, Step::Approve, version, &approver()).await.unwrap();
    let line = go(store, Step::Activate, version, &engineer()).await.unwrap().unwrap();
    assert_eq!(line.active, Some(version));
    version
}

fn code(result: StoreResult<impl std::fmt::Debug>) -> &'static str {
    match result {
        Err(StoreError::Conflict { code, .. }) => code,
        Err(StoreError::VersionMismatch { .. }) => "version_mismatch",
        Err(StoreError::VersionRequired { .. }) => "version_required",
        other => panic!("{other:?}"),
    }
}

async fn states(store: &dyn Store) -> Vec<VersionState> {
    let versions = store.profile_versions(&id("P1"), Page { after: None, limit: 10 }).await.unwrap();
    versions.iter().map(|version| version.state).collect()
}

async fn a_content_is_kept_once_under_one_line(store: Arc<dyn Store>) {
    assert_eq!(draft(&*store, "P1", 300.0).await, 1);
    assert_eq!(draft(&*store, "P1", 310.0).await, 2);
    let again = store.draft_profile(&id("P1"), new(300.0), &approver(), at(9)).await.unwrap();
    assert_eq!((again.version, again.is_new), (1, false));
    let found = store.profile_version(&id("P1"), 1).await.unwrap().unwrap();
    assert_eq!(found.content, new(300.0).content);
    assert_eq!(found.hash, profile_hash(&new(300.0).content));
    assert_eq!((found.drafted.by.as_str(), found.state), ("tok-eve", VersionState::Draft));

    // The subject belongs to P1; P1 belongs to its subject.
    let other = store.draft_profile(&id("P2"), new(300.0), &engineer(), at(1)).await;
    assert_eq!(code(other), "other_profile");
    let mut elsewhere = new(300.0);
    elsewhere.content = content(300.0, Some(1.03), 1.07);
    let other = store.draft_profile(&id("P1"), elsewhere.clone(), &engineer(), at(1)).await;
    assert_eq!(code(other), "other_subject");
    // Another wear band is another line.
    assert!(store.draft_profile(&id("P2"), elsewhere, &engineer(), at(1)).await.unwrap().is_new);
    let based = NewProfileVersion { based_on: Some(3), ..new(320.0) };
    assert_eq!(code(store.draft_profile(&id("P1"), based, &engineer(), at(1)).await), "unknown_base");

    let page = || Page { after: None, limit: 10 };
    let lines = store.feed_profiles(&FeedProfileFilter::default(), page()).await.unwrap();
    let names: Vec<_> = lines.iter().map(|line| (line.id.as_str(), line.newest, line.active)).collect();
    assert_eq!(names, [("P1", 2, None), ("P2", 1, None)]);
    assert_eq!(lines[1].wear_from_level, Some(1.03));
    let filter = FeedProfileFilter { tool_type: Some("another".to_owned()), ..FeedProfileFilter::default() };
    assert!(store.feed_profiles(&filter, page()).await.unwrap().is_empty());
    let after = store.profile_versions(&id("P1"), Page { after: Some(1), limit: 10 }).await.unwrap();
    assert_eq!(after.len(), 1);
    assert_eq!(store.feed_profile(&id("P9")).await.unwrap(), None);
}

async fn a_version_goes_its_way_by_two_people_and_back_in_one_call(store: Arc<dyn Store>) {
    let store = &*store;
    let first = draft(store, "P1", 300.0).await;
    assert_eq!(code(go(store, Step::Approve, first, &approver()).await), "wrong_state");
    go(store, Step::Shadow, first, &engineer()).await.unwrap();
    assert_eq!(code(go(store, Step::Activate, first, &engineer()).await), "wrong_state");
    assert_eq!(code(go(store, Step::Approve, first, &engineer()).await), "own_draft");
    let step = ProfileMove::Step(Step::Approve, first);
    let unnamed = store.move_profile(&id("P1"), step, Precondition::Unstated, &approver(), at(2)).await;
    assert_eq!(code(unnamed), "version_required");
    let stale = store.move_profile(&id("P1"), step, Precondition::Version(1), &approver(), at(2)).await;
    assert_eq!(code(stale), "version_mismatch");
    go(store, Step::Approve, first, &approver()).await.unwrap();
    assert_eq!(code(go(store, Step::Shadow, first, &engineer()).await), "wrong_state");
    let line = go(store, Step::Activate, first, &approver()).await.unwrap().unwrap();
    // A repeated call changes nothing.
    assert_eq!(go(store, Step::Activate, first, &approver()).await.unwrap().unwrap(), line);
    assert_eq!(go(store, Step::Shadow, 9, &engineer()).await.unwrap(), None);

    let second = activated(store, 310.0).await;
    let third = activated(store, 320.0).await;
    assert_eq!(
        states(store).await,
        [VersionState::Superseded, VersionState::Superseded, VersionState::Active]
    );
    let back = async || {
        let line = store.feed_profile(&id("P1")).await.unwrap().unwrap();
        let expects = Precondition::Version(line.revision);
        store.move_profile(&id("P1"), ProfileMove::Rollback, expects, &engineer(), at(5)).await
    };
    assert_eq!(back().await.unwrap().unwrap().active, Some(second));
    assert_eq!(back().await.unwrap().unwrap().active, Some(first));
    // Nothing is left that was not rolled back itself: the programs run as they are.
    assert_eq!(back().await.unwrap().unwrap().active, None);
    assert_eq!(code(back().await), "nothing_active");
    let rolled = store.profile_version(&id("P1"), third).await.unwrap().unwrap();
    assert!(rolled.rolled_back && rolled.superseded_at == Some(at(5)));
    // What was rolled back was approved once and may be activated again.
    assert_eq!(go(store, Step::Activate, third, &engineer()).await.unwrap().unwrap().active, Some(third));

    let audit = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    let count = |action: &str| audit.iter().filter(|line| line.action == action).count();
    assert_eq!(
        ["draft", "shadow", "approve", "activate", "rollback"]
            .map(|step| count(&format!("feed_profile.{step}"))),
        [3, 3, 3, 4, 3]
    );
}

async fn of_two_moves_at_once_exactly_one_wins(store: Arc<dyn Store>) {
    let (first, second) = (draft(&*store, "P1", 300.0).await, draft(&*store, "P1", 310.0).await);
    for version in [first, second] {
        go(&*store, Step::Shadow, version, &engineer()).await.unwrap();
        go(&*store, Step::Approve, version, &approver()).await.unwrap();
    }
    for round in 0..10 {
        let line = store.feed_profile(&id("P1")).await.unwrap().unwrap();
        let expects = Precondition::Version(line.revision);
        let moves = [first, second].map(|version| {
            let (store, who) = (Arc::clone(&store), engineer());
            tokio::spawn(async move {
                let step = ProfileMove::Step(Step::Activate, version);
                store.move_profile(&id("P1"), step, expects, &who, at(round)).await
            })
        });
        let [one, other] = moves;
        let outcomes = [one.await.unwrap(), other.await.unwrap()];
        // Whichever is active already changes nothing, so the other may follow it with the same revision.
        let won = outcomes.iter().filter(|outcome| outcome.is_ok()).count();
        let unchanged = line.active.is_some();
        assert!(won == 1 || (unchanged && won == 2), "{outcomes:?}");
        for outcome in outcomes.into_iter().filter(Result::is_err) {
            assert_eq!(code(outcome), "version_mismatch");
        }
        let active = states(&*store).await.into_iter().filter(|state| *state == VersionState::Active).count();
        assert_eq!(active, 1);
        let back = store.feed_profile(&id("P1")).await.unwrap().unwrap();
        assert!(back.active.is_some());
        if round % 2 == 0 {
            let expects = Precondition::Version(back.revision);
            store
                .move_profile(&id("P1"), ProfileMove::Rollback, expects, &engineer(), at(round))
                .await
                .unwrap();
        }
    }
}

fn reasons(advice: &Recommendation) -> Vec<&str> {
    advice
        .reasons
        .iter()
        .map(|(code, _)| code.as_str())
        .filter(|code| code.starts_with("profile") || *code == "no_profile")
        .collect()
}

async fn put(store: &dyn Store, change: impl FnOnce(&mut Operation)) {
    let known = store.operation(&operation("O1").id).await.unwrap().unwrap();
    let mut changed = operation("O1");
    change(&mut changed);
    store.put_operation(changed, Precondition::Version(known.version), &engineer(), at(3)).await.unwrap();
}

async fn only_the_active_version_that_fits_is_handed_out(store: Arc<dyn Store>) {
    let store = &*store;
    shop(store).await;
    let mut n = 0;
    let mut next = async |load: f64| {
        n += 1;
        let run = Run { seconds: 90_000 + i64::from(n) * 60, load, ..Run::nth(n) };
        stored(store, &run).await.recommendation.recommendation
    };
    let advice = next(30.0).await;
    assert_eq!((reasons(&advice), &advice.profile), (vec!["no_profile"], &None));
    let version = draft(store, "P1", 300.0).await;
    go(store, Step::Shadow, version, &engineer()).await.unwrap();
    assert_eq!(reasons(&next(30.0).await), ["no_profile"], "a shadow is computed, not handed out");
    go(store, Step::Approve, version, &approver()).await.unwrap();
    assert_eq!(reasons(&next(30.0).await), ["no_profile"], "approved is not active");
    go(store, Step::Activate, version, &engineer()).await.unwrap();

    let advice = next(30.0).await;
    assert_eq!(reasons(&advice), ["profile_active"]);
    let profile = advice.profile.unwrap();
    assert_eq!(profile.version, ProfileVersion { profile: id("P1"), version });
    assert_eq!(profile.hash, profile_hash(&new(300.0).content));
    assert_eq!((advice.feed_mm_min, advice.override_percent), (None, 100.0));

    put(store, |operation| operation.program = Some("O2000".to_owned())).await;
    let advice = next(30.0).await;
    assert_eq!((reasons(&advice), &advice.profile), (vec!["profile_other_program"], &None));
    put(store, |operation| operation.work_material = Some("1.4301".to_owned())).await;
    assert_eq!(reasons(&next(30.0).await), ["profile_other_material"]);
    put(store, |operation| operation.work_material = None).await;
    assert_eq!(reasons(&next(30.0).await), ["profile_other_material"], "what is not known does not match");
    // Within what counts as a complete cycle, and yet another depth.
    put(store, |operation| operation.depth_mm = Some(5.2)).await;
    assert_eq!(reasons(&next(30.0).await), ["profile_other_depth"]);
    put(store, |_| {}).await;
    for _ in 0..6 {
        next(30.0).await;
    }
    assert_eq!(reasons(&next(30.0).await), ["profile_active"]);
    // The tool wears beyond what the version holds to, and not yet to the limit.
    let mut last = Vec::new();
    for _ in 0..8 {
        last = reasons(&next(32.2).await).into_iter().map(str::to_owned).collect();
    }
    assert_eq!(last, ["profile_beyond_wear"]);
    let of_none = store.active_profiles(&operation("O1").id, &"T9".try_into().unwrap()).await.unwrap();
    assert_eq!(of_none, ActiveProfiles::default());
}

async fn the_cycles_of_a_version_are_found(store: Arc<dyn Store>) {
    shop(&*store).await;
    activated(&*store, 300.0).await;
    let ran = |version| ProfileVersion { profile: id("P1"), version };
    for n in 1..=6 {
        let mut cycle = Run::nth(n).draft();
        cycle.profile = (n != 3).then(|| ran(if n > 4 { 2 } else { 1 }));
        let group = vec![super::given::new_cycle(Cycle::new(cycle).unwrap())];
        let answers = store.commit_cycles(group, at(1000), RecommendSettings::default()).await;
        let [Ok(Committed::Stored(answer))] = answers.as_slice() else { panic!("{answers:?}") };
        let codes = reasons(&answer.recommendation.recommendation);
        // Version 2 is not active: whoever looks at the answer sees that something else ran.
        assert_eq!(codes.contains(&"profile_mismatch"), n > 4, "{codes:?}");
    }
    let of = async |version, most| {
        let found = store.cycles_of_profile(&ran(version), most).await.unwrap();
        found.iter().map(|stored| stored.cycle.id.as_str().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(of(1, 10).await, ["c00001", "c00002", "c00004"]);
    assert_eq!(of(1, 2).await, ["c00002", "c00004"], "the newest, oldest first");
    assert_eq!(of(2, 10).await, ["c00005", "c00006"]);
    let recent = store.recent_cycles(&operation("O1").id, "friction-6", 4).await.unwrap();
    assert_eq!(recent.len(), 4);
    assert_eq!(recent[3].cycle.id.as_str(), "c00006");
    assert!(store.recent_cycles(&operation("O1").id, "other", 4).await.unwrap().is_empty());
}

/// What is found is held against the list of all. Cycles begin at the same time on two machines and with two tools.
async fn the_last_cycles_with_a_type_of_tool_are_found_whether_few_have_it_or_many(store: Arc<dyn Store>) {
    shop(&*store).await;
    let who = engineer();
    let typed = |id: &str, tool_type: &str| Tool { tool_type: tool_type.to_owned(), ..tool(id) };
    store.put_machine(machine("M2"), Precondition::Absent, &who, at(0)).await.unwrap();
    store.put_operation(operation("O2"), Precondition::Absent, &who, at(0)).await.unwrap();
    for (id, tool_type) in [("T2", "friction-6"), ("T3", "other"), ("T4", "friction-6")] {
        store.put_tool(typed(id, tool_type), Precondition::Absent, &who, at(0)).await.unwrap();
    }
    for n in 0..24_u32 {
        let run = Run {
            machine: ["M1", "M2"][n as usize % 2],
            tool: format!("T{}", [1, 3, 2, 3, 1][n as usize % 5]),
            operation: if n % 7 == 0 { "O2" } else { "O1" },
            seconds: i64::from(n / 4) * 60,
            seq: (n % 3 != 0).then(|| u64::from(n)),
            ..Run::nth(n)
        };
        stored(&*store, &run).await;
    }
    let of_o1 = CycleFilter { operation: Some(operation("O1").id), ..CycleFilter::default() };
    let all = store.cycles(&of_o1, Page { after: None, limit: 1000 }).await.unwrap();
    let of_type: Vec<_> = all.into_iter().filter(|it| it.cycle.tool.as_str() != "T3").collect();
    assert!(of_type.len() > 10, "{}", of_type.len());
    let found = async |most: usize| {
        let most = u32::try_from(most).unwrap();
        store.recent_cycles(&operation("O1").id, "friction-6", most).await.unwrap()
    };
    for many in [false, true] {
        if many {
            for n in 0..100 {
                let other = typed(&format!("never-ran-{n}"), "friction-6");
                store.put_tool(other, Precondition::Absent, &who, at(0)).await.unwrap();
            }
        }
        for most in 1..=of_type.len() + 1 {
            let last = &of_type[of_type.len().saturating_sub(most)..];
            assert_eq!(found(most).await, last, "the last {most} of many tools: {many}");
        }
    }
}
