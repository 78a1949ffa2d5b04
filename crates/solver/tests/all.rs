//! Tests of the solver from outside, in one binary.

mod all {
    mod checkpoint;
    mod classic;
    mod determinism;
    mod domain;
    mod elimination;
    mod holds;
    mod nist;
    mod priors;
    mod stops;
    mod support;

    #[test]
    fn no_file_was_forgotten() {
        let list = include_str!("all.rs");
        for entry in
            std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all")).expect("the tests are here")
        {
            let name = entry.expect("its entries are readable").file_name();
            let name = name.to_str().expect("names are ASCII");
            let Some(module) = name.strip_suffix(".rs") else { continue };
            assert!(list.contains(&format!("mod {module};")), "{name} is not in tests/all.rs");
        }
    }
}
