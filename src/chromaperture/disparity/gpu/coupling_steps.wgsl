// `steps` primal-dual iterations of total variation with a quadratic data term; see `stages/variation.py`. A workgroup
// loads a square of 32 x 32 pixels, iterates in shared memory and stores the inner pixels, which nothing beyond the
// square has reached: an iteration reaches one pixel further.

@group(0) @binding(0) var<storage, read> before: array<vec4f>;  // (h, w): u, its extrapolation, dual
@group(0) @binding(1) var<storage, read_write> after: array<vec4f>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;  // (h, w), layers
@group(0) @binding(3) var<storage, read> links: array<vec2f>;  // (h, w)
@group(0) @binding(4) var<storage, read> couplings: array<f32>;
@group(0) @binding(5) var<storage, read> round: array<u32>;

const side = 32u;
const inner = side - 2u * steps;

var<workgroup> extrapolated: array<f32, 1024>;
var<workgroup> flow: array<vec2f, 1024>;  // dual times links

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let weight = 1.0 / couplings[round[0]];
    var u: array<f32, 4>;
    var dual: array<vec2f, 4>;
    var link: array<vec2f, 4>;
    var target_u: array<f32, 4>;
    var inside: array<bool, 4>;
    for (var i = 0u; i < 4u; i++) {
        let slot = vec2u(local.x + 16u * (i & 1u), local.y + 16u * (i >> 1u));
        let at = vec2i(group.xy * inner + slot) - i32(steps);
        inside[i] = all(at >= vec2i(0i)) && at.x < i32(width) && at.y < i32(height);
        var state = vec4f();
        if (inside[i]) {
            let pixel = u32(at.y) * width + u32(at.x);
            state = before[pixel];
            target_u[i] = goal[pixel];
            // No link beyond the last column and row: the gradient is 0 there.
            link[i] = links[pixel] * vec2f(f32(at.x + 1i < i32(width)), f32(at.y + 1i < i32(height)));
        }
        u[i] = state.x;
        dual[i] = state.zw;
        extrapolated[slot.y * side + slot.x] = select(state.y, state.x, is_fresh);
        flow[slot.y * side + slot.x] = vec2f();
    }
    workgroupBarrier();
    let pull = primal_step * weight;
    for (var n = 0u; n < steps; n++) {
        for (var i = 0u; i < 4u; i++) {
            let slot = vec2u(local.x + 16u * (i & 1u), local.y + 16u * (i >> 1u));
            let k = slot.y * side + slot.x;
            let here = extrapolated[k];
            let slopes = vec2f(extrapolated[min(k + 1u, 1023u)], extrapolated[min(k + side, 1023u)]) - here;
            var p = (dual[i] + dual_step * link[i] * slopes) / (1.0 + dual_step * huber);
            p /= max(1.0, length(p));
            dual[i] = select(vec2f(), p, inside[i]);
            flow[k] = dual[i] * link[i];
        }
        workgroupBarrier();
        for (var i = 0u; i < 4u; i++) {
            let slot = vec2u(local.x + 16u * (i & 1u), local.y + 16u * (i >> 1u));
            let k = slot.y * side + slot.x;
            let from_left = select(flow[max(k, 1u) - 1u].x, 0.0, slot.x == 0u);
            let from_above = select(flow[max(k, side) - side].y, 0.0, slot.y == 0u);
            let divergence = flow[k].x - from_left + flow[k].y - from_above;
            let moved = (u[i] + primal_step * divergence + pull * target_u[i]) / (1.0 + pull);
            let next = clamp(moved, 0.0, highest);
            extrapolated[k] = next + (next - u[i]);
            u[i] = next;
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < 4u; i++) {
        let slot = vec2u(local.x + 16u * (i & 1u), local.y + 16u * (i >> 1u));
        let at = vec2i(group.xy * inner + slot) - i32(steps);
        let kept = all(slot >= vec2u(steps)) && all(slot < vec2u(side - steps));
        if (kept && inside[i]) {
            let pixel = u32(at.y) * width + u32(at.x);
            after[pixel] = vec4f(u[i], extrapolated[slot.y * side + slot.x], dual[i]);
        }
    }
}
