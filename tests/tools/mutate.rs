//! Mutants of a unit: most are killed by its shortest runs, a seed reproduces them, and one can be run alone.

use dynrt::config::Config;
use dynrt::mutate::{Kind, Mutant, Outcome, Report, Request, UNITS, mutate};

/// Mutants of each unit, and the request that gives as many: one for the five units of the core.
const EACH: usize = 24;
const REQUESTED: u32 = 5 * EACH as u32;

fn request(seed: u64) -> Request {
    Request {
        units: vec!["update".into()],
        prove: false,
        lengths: 1,
        ..Request::new(REQUESTED, seed)
    }
}

fn run(request: &Request) -> Report {
    mutate(
        &Config::reference(),
        request,
        &|line| println!("{line}"),
        &|_, _| (),
    )
    .unwrap_or_else(|error| panic!("{error:#}"))
}

fn drawn(mutants: &[Mutant]) -> Vec<(u32, &str, usize, &str)> {
    let place = |m: &'_ Mutant| (m.number, m.line);
    (mutants.iter())
        .map(|m| (place(m).0, m.module.as_str(), place(m).1, m.after.as_str()))
        .collect()
}

#[test]
fn mutants_are_noticed_and_come_again() {
    let report = run(&request(1));
    for mutant in report.survivors() {
        println!("survived the shortest run: {mutant:?}");
    }
    assert_eq!(report.mutants.len(), EACH);
    for kind in Kind::ALL {
        assert!(
            report.mutants.iter().any(|m| m.kind == kind),
            "{}",
            kind.name()
        );
    }
    // Only the shortest run, without proofs; the full set of runs kills more.
    assert!(report.share_percent() >= 75.0, "{}", report.share_percent());
    let noticed =
        |m: &&Mutant| matches!(&m.outcome, Outcome::Noticed { how, .. } if !how.is_empty());
    let first = report.mutants.iter().find(noticed).expect("one is noticed");
    let alone = run(&Request {
        only: Some(first.number),
        ..request(1)
    });
    assert_eq!(alone.mutants, std::slice::from_ref(first));
    let again = run(&request(1));
    assert_eq!(drawn(&report.mutants), drawn(&again.mutants));
    let other = run(&Request {
        lengths: 0,
        ..request(2)
    });
    assert_ne!(drawn(&report.mutants), drawn(&other.mutants));
    // Without a run no mutant can be killed: only runs contribute to the score.
    assert_eq!(other.noticed(), 0);
    assert_eq!(other.share_percent(), 0.0);
}

#[test]
fn what_is_not_there_is_refused_in_one_line() {
    let config = Config::reference();
    let mut unknown = request(1);
    unknown.units = vec!["shader".into()];
    let cases = [
        (
            unknown,
            "unit shader: is not one of arithmetic, tpu, geometry, update, raycast, cache",
        ),
        (
            Request {
                only: Some((EACH * UNITS.len()) as u32 + 1),
                ..request(1)
            },
            "there is no such mutant",
        ),
        (Request::new(0, 1), "nothing would be checked"),
    ];
    for (request, said) in cases {
        let error = mutate(&config, &request, &|_| (), &|_, _| ()).unwrap_err();
        let line = format!("{error:#}");
        assert!(line.contains(said) && line.lines().count() == 1, "{line}");
    }
}
