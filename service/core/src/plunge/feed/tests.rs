use proptest::prelude::*;

use super::*;

fn material() -> Material {
    let thrust =
        DrillingLaw { coefficient: 680.0, diameter_exponent: 1.0, feed_exponent: 0.7, correction: 1.0 };
    let torque =
        DrillingLaw { coefficient: 345.0, diameter_exponent: 2.0, feed_exponent: 0.8, correction: 1.0 };
    Material::new(MaterialInput { name: "steel 45".into(), thrust, torque }).unwrap()
}

fn drill(diameter_mm: f64, length_mm: f64) -> Drill {
    let input = DrillInput {
        diameter_mm,
        length_mm,
        spindle_rpm: 1000.0,
        modulus_n_mm2: None,
        shear_strength_n_mm2: None,
    };
    Drill::new(input).unwrap()
}

fn machine(least_feed_mm_min: f64, greatest_feed_mm_min: f64) -> Machine {
    Machine::new(MachineInput { least_feed_mm_min, greatest_feed_mm_min }).unwrap()
}

#[test]
fn the_papers_constants_come_out() {
    // P_kp ≈ 18·10³·d⁴/l² (2π²·2.1·10⁵·0.0052/(1 + 0.0052/0.027) = 18 074), M_kp ≈ 29·d³ for τ_p = 620.
    let unit = drill(1.0, 1.0);
    assert!((unit.critical_thrust_n() - 18_074.0).abs() < 0.5, "{}", unit.critical_thrust_n());
    let scaled = drill(8.0, 100.0).critical_thrust_n();
    assert!((scaled / (18_074.0 * 8.0_f64.powi(4) / 1e4) - 1.0).abs() < 1e-4);
    let weak = DrillInput { shear_strength_n_mm2: Some(620.0), ..unit.input };
    assert!((Drill::new(weak).unwrap().critical_torque_n_mm() - 29.14).abs() < 1e-9);
}

#[test]
fn every_limit_binds_somewhere_in_a_tool_table() {
    let table = [drill(3.0, 300.0), drill(10.0, 40.0), drill(6.0, 120.0)];
    let wide = machine(1.0, 1e5);
    let feeds = plunge_feeds(&table, &material(), &wide, None).unwrap();
    assert_eq!(feeds[0].limit, PlungeLimit::Stability);
    assert_eq!(feeds[1].limit, PlungeLimit::Torsion);
    // At the advised feed the law gives back exactly what the drill bears.
    let thrust = 680.0 * 3.0 * feeds[0].feed_mm_rev.unwrap().powf(0.7);
    assert!((thrust / feeds[0].critical_thrust_n - 1.0).abs() < 1e-12);
    let torque = 345.0 * 100.0 * feeds[1].feed_mm_rev.unwrap().powf(0.8);
    assert!((torque / feeds[1].critical_torque_n_mm - 1.0).abs() < 1e-12);

    let slow = plunge_feed(&table[1], &material(), &machine(1.0, 100.0), None);
    assert_eq!((slow.limit, slow.feed_mm_min), (PlungeLimit::MachineMaximum, Some(100.0)));
    let coarse = plunge_feed(&table[0], &material(), &machine(9e4, 1e5), None);
    assert_eq!((coarse.limit, coarse.feed_mm_min), (PlungeLimit::Impossible, None));
}

#[test]
fn a_feed_that_is_none_is_not_advised_though_the_machine_declares_no_least() {
    let mut law =
        DrillingLaw { coefficient: 1e9, diameter_exponent: 1.0, feed_exponent: 0.01, correction: 1.0 };
    let torque = DrillingLaw { coefficient: 1.0, feed_exponent: 0.8, ..law };
    let without_least = machine(0.0, 1e5);
    for exponent in [0.01, 0.05, 0.3] {
        law.feed_exponent = exponent;
        let Ok(material) = Material::new(MaterialInput { name: "hard".into(), thrust: law, torque }) else {
            continue;
        };
        let found = plunge_feed(&drill(0.5, 300.0), &material, &without_least, None);
        assert_eq!((found.feed_mm_min, found.limit), (None, PlungeLimit::Impossible), "{found:?}");
    }
}

#[test]
fn a_slow_loop_bounds_the_feed_and_the_bite_is_told() {
    // Four samples of 8 ms and an answer 10 ms old at 3000 mm/min: more than 2 mm.
    let input = LoopLatencyInput {
        allowed_bite_mm: 0.1,
        detector_samples: 4,
        sample_period_s: 0.008,
        answer_age_s: 0.010,
    };
    let latency = LoopLatency::new(input).unwrap();
    assert!(latency.bite_mm(3000.0) > 2.0);
    let fast = plunge_feed(&drill(10.0, 40.0), &material(), &machine(1.0, 3000.0), Some(&latency));
    assert_eq!(fast.limit, PlungeLimit::LoopLatency);
    assert!((fast.bite_mm.unwrap() - 0.1).abs() < 1e-12);
    assert!((fast.feed_mm_min.unwrap() - 0.1 / 0.042 * 60.0).abs() < 1e-9);
    let never = plunge_feed(&drill(10.0, 40.0), &material(), &machine(200.0, 3000.0), Some(&latency));
    assert_eq!((never.limit, never.feed_mm_min, never.bite_mm), (PlungeLimit::LoopTooSlow, None, None));
}

#[test]
fn bad_input_is_refused_by_name() {
    let base = drill(5.0, 50.0).input;
    let refused = |input| Drill::new(input).unwrap_err().field();
    assert_eq!(refused(DrillInput { diameter_mm: f64::NAN, ..base }), "diameter_mm");
    assert_eq!(refused(DrillInput { modulus_n_mm2: Some(-1.0), ..base }), "modulus_n_mm2");
    let inverted = MachineInput { least_feed_mm_min: 10.0, greatest_feed_mm_min: 5.0 };
    assert_eq!(Machine::new(inverted).unwrap_err().code(), "inverted_range");
    let nameless = MaterialInput { name: String::new(), ..material().0 };
    assert_eq!(Material::new(nameless).unwrap_err().code(), "empty");
    let refused = plunge_feeds(&[], &material(), &machine(1.0, 2.0), None).unwrap_err();
    assert_eq!((refused.field(), refused.code()), ("drills", "empty"));
}

proptest! {
    #[test]
    fn an_advised_feed_breaks_nothing(
        d in 0.5..40.0_f64, l in 5.0..500.0_f64, rpm in 50.0..20_000.0_f64, bite in 0.01..1.0_f64
    ) {
        let input = DrillInput { spindle_rpm: rpm, ..drill(d, l).input };
        let latency = LoopLatency::new(LoopLatencyInput {
            allowed_bite_mm: bite, detector_samples: 4, sample_period_s: 0.01, answer_age_s: 0.005,
        }).unwrap();
        let drill = Drill::new(input).unwrap();
        let answer = plunge_feed(&drill, &material(), &machine(5.0, 5000.0), Some(&latency));
        if let Some(feed) = answer.feed_mm_rev {
            let law = material().0;
            let slack = 1.0 + 1e-9;
            prop_assert!(law.thrust.coefficient * d * feed.powf(0.7) <= answer.critical_thrust_n * slack);
            prop_assert!(law.torque.coefficient * d * d * feed.powf(0.8) <= answer.critical_torque_n_mm * slack);
            prop_assert!((5.0..=5000.0 * slack).contains(&(feed * rpm)));
            prop_assert!(answer.bite_mm.is_some_and(|found| found <= bite * slack));
        } else {
            prop_assert!(matches!(answer.limit, PlungeLimit::Impossible | PlungeLimit::LoopTooSlow));
        }
    }
}
