// Sums over the invocations that share a window, through shared memory; all of them get the same sum.
const lanes = 8u;

var<workgroup> lane_sums: array<vec3f, 64>;
var<private> lane_here: u32;

fn sum_of_lanes(own: vec3f) -> vec3f {
    workgroupBarrier();
    lane_sums[lane_here] = own;
    workgroupBarrier();
    let first = lane_here - lane_here % lanes;
    var sum = lane_sums[first];
    for (var k = 1u; k < lanes; k++) { sum += lane_sums[first + k]; }
    return sum;
}
