//! The rules with three Board Cs: all but that of encoders with few counts, which C620 drives do
//! not have.

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
    rule_1_permitted_scale_is_that_of_its_own_wheels
    rule_2_twist_takes_effect_the_agreement_delay_after_its_sync
    rule_2_one_slow_member_slows_the_whole_body_and_the_body_keeps_its_shape
    rule_2_keeps_free_robots_in_shape_where_clipping_tears_the_load
    rule_3_a_missing_member_stops_the_others_by_ramp
    rule_3_a_member_that_is_not_operational_stops_the_others_by_ramp
    rule_3_a_member_in_fault_stops_the_others_by_ramp
    rule_3_a_member_with_another_sequence_stops_the_others_by_ramp
    rule_3_a_member_that_would_do_something_else_stops_the_group
    rule_3_a_protective_stop_of_one_is_a_ramp_of_all
    rule_3_emergency_stop_cuts_its_own_drivers_and_stops_the_rest_by_ramp
    rule_4_loss_of_the_masters_heartbeat_is_the_same_ramp
    rule_4_loss_of_sync_is_the_same_ramp
    rule_4_an_overdue_setpoint_is_the_same_ramp
    a_bus_that_comes_apart_keeps_the_shape_within_three_millimetres
    rule_4_restart_needs_an_nmt_start
    rule_4_restart_needs_a_new_sequence
    rule_5_disagreement_of_the_members_is_a_limit_then_a_fault
    rule_6_a_limit_moves_and_a_fault_is_latched_with_outputs_off
}
