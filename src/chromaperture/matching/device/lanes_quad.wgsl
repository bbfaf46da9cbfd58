// Four invocations share a path: each holds every fourth vector of four layers, and the least cost goes round the quad.
const lanes = 4u;
var<private> lane_here: u32;

fn least_of_lanes(own: f32) -> f32 {
    let pair = min(own, quadSwapX(own));
    return min(pair, quadSwapY(pair));
}
