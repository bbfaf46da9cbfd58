// The form of `choices_shared.wgsl` for a device in software, where the barriers of a step take ten times as long as the
// step: one invocation has a line alone.
const lanes = 1u;

fn least_of_all(own: f32, local: u32) -> f32 {
    return own;
}
