// The form of `sums_shared.wgsl` for a device in software, where barriers take long: one invocation has a window alone.
const lanes = 1u;
var<private> lane_here: u32;

fn sum_of_lanes(own: vec3f) -> vec3f {
    return own;
}
