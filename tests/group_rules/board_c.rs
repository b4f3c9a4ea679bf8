//! A sample of the rules with three Board Cs.

fn images() -> sim::Backend {
    let path = std::env::var("OMNIBUS_ELF_BOARD_C")
        .expect("OMNIBUS_ELF_BOARD_C names Board C's image; cargo xtask test sets it");
    let image = emulator::Firmware::load(&path);
    sim::Backend::Images(vec![
        image.unwrap_or_else(|error| panic!("{path}: {error}")),
    ])
}

macro_rules! sample {
    ($($rule:ident)*) => { $(#[test] fn $rule() { super::$rule(&images()); })* };
}

sample! {
    rule_1_twist_is_latched_at_sync_and_published_with_its_sequence
    rule_2_twist_takes_effect_the_agreement_delay_after_its_sync
    rule_3_a_missing_member_stops_the_others_by_ramp
    rule_3_a_protective_stop_of_one_is_a_ramp_of_all
    rule_3_emergency_stop_cuts_its_own_drivers_and_stops_the_rest_by_ramp
    rule_4_loss_of_sync_is_the_same_ramp
    rule_4_restart_needs_an_nmt_start
}
