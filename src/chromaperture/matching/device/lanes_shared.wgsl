// The form of `lanes_quad.wgsl` for devices without subgroups: the least cost goes through shared memory.
const lanes = 4u;

var<workgroup> lane_costs: array<f32, 64>;
var<private> lane_here: u32;

fn least_of_lanes(own: f32) -> f32 {
    workgroupBarrier();
    lane_costs[lane_here] = own;
    workgroupBarrier();
    let quad = lane_here & ~3u;
    return min(min(lane_costs[quad], lane_costs[quad + 1u]), min(lane_costs[quad + 2u], lane_costs[quad + 3u]));
}
