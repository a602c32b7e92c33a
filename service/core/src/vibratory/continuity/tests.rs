use super::*;

fn steady(p: f64, kc: f64, control: bool) -> Steady {
    let control = control.then_some(ContinuityControl::GOUSKOV_2015);
    simulate(&Process::new(ProcessInput::gouskov_2015(p, kc, control)).unwrap())
}

#[test]
fn explore() {
    for (name, p, kc) in [("A",1.5,0.1),("B",1.5,0.02),("C",1.5,0.6),("D",1.7,0.1),("E",1.2,0.1)] {
        println!("{name} free {:?}", steady(p,kc,false));
        println!("{name} ctrl {:?}", steady(p,kc,true));
    }
    for p in [1.2,1.5,1.7,1.74,1.75] { println!("{p} {:?}", border_at(p,0.01,0.75)); }
}
#[test]
fn explore2() {
    for sp in [100, 200, 250, 300, 400] { for per in [500, 600, 1000] {
    for (name, p, kc) in [("A",1.5,0.1),("B",1.5,0.02),("C",1.5,0.6),("D",1.7,0.1),("E",1.2,0.1)] {
        let s = simulate(&Process::new(ProcessInput{steady_periods: sp, periods: per, ..ProcessInput::gouskov_2015(p, kc, Some(ContinuityControl::GOUSKOV_2015))}).unwrap());
        println!("{sp} {per} {name} {:.3} {:.3} ", s.window_sd, s.continuity);
    }}}
}
