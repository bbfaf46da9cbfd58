// One invocation walks a path alone: no exchange, and a quarter of the invocations of `lanes_quad.wgsl`.
const lanes = 1u;
var<private> lane_here: u32;

fn least_of_lanes(own: f32) -> f32 {
    return own;
}
