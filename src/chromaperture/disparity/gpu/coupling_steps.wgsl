// `steps` primal-dual iterations of total variation with a quadratic data term; see `stages/variation.py`. A workgroup
// loads 16 x 16 blocks, iterates and stores the inner pixels, which nothing beyond has reached: an iteration reaches one
// pixel further. An invocation keeps a block of 4 x 4 in registers; only what its neighbours read goes through shared
// memory. Rows have names, because arrays of registers cost a software device half of its time.

@group(0) @binding(0) var<storage, read> before: array<vec4f>;  // (h, w): u, its extrapolation, dual
@group(0) @binding(1) var<storage, read_write> after: array<vec4f>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;  // (h, w), layers
@group(0) @binding(3) var<storage, read> links: array<vec2f>;  // (h, w)
@group(0) @binding(4) var<storage, read> couplings: array<f32>;
@group(0) @binding(5) var<storage, read> round: array<u32>;

// Of every block: the extrapolation of its first column and row, the flow (dual times links) out of its last ones.
var<workgroup> first_column: array<vec4f, 256>;
var<workgroup> last_column: array<vec4f, 256>;
var<workgroup> first_row: array<vec4f, 256>;
var<workgroup> last_row: array<vec4f, 256>;

// Four neighbours of a row.
struct Row { u: vec4f, ahead: vec4f, dual_x: vec4f, dual_y: vec4f, link_x: vec4f, link_y: vec4f, goal: vec4f }

fn is_inside(at: vec2i) -> bool {
    return all(at >= vec2i(0i)) && at.x < i32(width) && at.y < i32(height);
}

fn loaded(corner: vec2i) -> Row {
    var row: Row;
    for (var x = 0u; x < 4u; x++) {
        let at = corner + vec2i(i32(x), 0i);
        if (is_inside(at)) {
            let pixel = u32(at.y) * width + u32(at.x);
            let state = before[pixel];
            // No link beyond the last column and row: the gradient is 0 there.
            let link = links[pixel] * vec2f(f32(at.x + 1i < i32(width)), f32(at.y + 1i < i32(height)));
            row.u[x] = state.x;
            row.ahead[x] = select(state.y, state.x, is_fresh);
            row.dual_x[x] = state.z;
            row.dual_y[x] = state.w;
            row.link_x[x] = link.x;
            row.link_y[x] = link.y;
            row.goal[x] = goal[pixel];
        }
    }
    return row;
}

// The flow to the right of four rows.
fn out_of(first: Row, second: Row, third: Row, fourth: Row) -> vec4f {
    return vec4f(first.dual_x.w, second.dual_x.w, third.dual_x.w, fourth.dual_x.w)
        * vec4f(first.link_x.w, second.link_x.w, third.link_x.w, fourth.link_x.w);
}

// Links are 0 outside of the picture, where the dual stays 0.
fn dual(row: Row, beside: vec4f, under: vec4f) -> Row {
    var next = row;
    let damping = 1.0 / (1.0 + dual_step * huber);
    let along = (row.dual_x + dual_step * row.link_x * (beside - row.ahead)) * damping;
    let down = (row.dual_y + dual_step * row.link_y * (under - row.ahead)) * damping;
    let shorter = inverseSqrt(max(vec4f(1.0), along * along + down * down));
    next.dual_x = along * shorter;
    next.dual_y = down * shorter;
    return next;
}

fn primal(row: Row, before: f32, over: vec4f, pull: f32, share: f32) -> Row {
    var next = row;
    let flow = row.dual_x * row.link_x;
    let divergence = flow - vec4f(before, flow.xyz) + row.dual_y * row.link_y - over;
    next.u = clamp((row.u + primal_step * divergence + pull * row.goal) * share, vec4f(), vec4f(highest));
    next.ahead = next.u + (next.u - row.u);
    return next;
}

fn store(row: Row, slot: vec2u, corner: vec2i) {
    for (var x = 0u; x < 4u; x++) {
        let place = slot + vec2u(x, 0u);
        let at = corner + vec2i(i32(x), 0i);
        let kept = all(place >= vec2u(steps)) && all(place < vec2u(64u, 64u) - steps);
        if (kept && is_inside(at)) {
            after[u32(at.y) * width + u32(at.x)] = vec4f(row.u[x], row.ahead[x], row.dual_x[x], row.dual_y[x]);
        }
    }
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) number: u32
) {
    let corner = vec2i(group.xy * (vec2u(64u, 64u) - 2u * steps) + vec2u(4u, 4u) * local.xy) - i32(steps);
    var first = loaded(corner);
    var second = loaded(corner + vec2i(0i, 1i));
    var third = loaded(corner + vec2i(0i, 2i));
    var fourth = loaded(corner + vec2i(0i, 3i));
    first_column[number] = vec4f(first.ahead.x, second.ahead.x, third.ahead.x, fourth.ahead.x);
    first_row[number] = first.ahead;
    workgroupBarrier();
    let right = min(number + 1u, 255u);
    let left = max(number, 1u) - 1u;
    let below = min(number + 16u, 255u);
    let above = max(number, 16u) - 16u;
    let pull = primal_step / couplings[round[0]];
    let share = 1.0 / (1.0 + pull);
    for (var n = 0u; n < steps; n++) {
        let beside = first_column[right];
        first = dual(first, vec4f(first.ahead.yzw, beside.x), second.ahead);
        second = dual(second, vec4f(second.ahead.yzw, beside.y), third.ahead);
        third = dual(third, vec4f(third.ahead.yzw, beside.z), fourth.ahead);
        fourth = dual(fourth, vec4f(fourth.ahead.yzw, beside.w), first_row[below]);
        last_column[number] = out_of(first, second, third, fourth);
        last_row[number] = fourth.dual_y * fourth.link_y;
        workgroupBarrier();
        let before = select(last_column[left], vec4f(), local.x == 0u);
        let over = select(last_row[above], vec4f(), local.y == 0u);
        fourth = primal(fourth, before.w, third.dual_y * third.link_y, pull, share);
        third = primal(third, before.z, second.dual_y * second.link_y, pull, share);
        second = primal(second, before.y, first.dual_y * first.link_y, pull, share);
        first = primal(first, before.x, over, pull, share);
        first_column[number] = vec4f(first.ahead.x, second.ahead.x, third.ahead.x, fourth.ahead.x);
        first_row[number] = first.ahead;
        workgroupBarrier();
    }
    store(first, vec2u(4u, 4u) * local.xy, corner);
    store(second, vec2u(4u, 4u) * local.xy + vec2u(0u, 1u), corner + vec2i(0i, 1i));
    store(third, vec2u(4u, 4u) * local.xy + vec2u(0u, 2u), corner + vec2i(0i, 2i));
    store(fourth, vec2u(4u, 4u) * local.xy + vec2u(0u, 3u), corner + vec2i(0i, 3i));
}
