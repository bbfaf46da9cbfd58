// `steps` primal-dual iterations of total variation with a quadratic data term; see `stages/variation.py`. A workgroup
// loads 16 x 16 blocks, iterates and stores the inner pixels, which nothing beyond has reached: an iteration reaches one
// pixel further. An invocation keeps a block of 4 columns and `tall` rows in registers; only what its neighbours read
// goes through shared memory.

@group(0) @binding(0) var<storage, read> before: array<vec4f>;  // (h, w): u, its extrapolation, dual
@group(0) @binding(1) var<storage, read_write> after: array<vec4f>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;  // (h, w), layers
@group(0) @binding(3) var<storage, read> links: array<vec2f>;  // (h, w)
@group(0) @binding(4) var<storage, read> couplings: array<f32>;
@group(0) @binding(5) var<storage, read> round: array<u32>;

// Of every block: the extrapolation of its first column and row, the flow (dual times links) out of its last ones.
var<workgroup> first_column: array<f32, 256u * tall>;
var<workgroup> last_column: array<f32, 256u * tall>;
var<workgroup> first_row: array<vec4f, 256>;
var<workgroup> last_row: array<vec4f, 256>;

fn is_inside(at: vec2i) -> bool {
    return all(at >= vec2i(0i)) && at.x < i32(width) && at.y < i32(height);
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) number: u32
) {
    let weight = 1.0 / couplings[round[0]];
    // A vector has the four columns of a row.
    var u: array<vec4f, tall>;
    var ahead: array<vec4f, tall>;  // extrapolated
    var dual_x: array<vec4f, tall>;
    var dual_y: array<vec4f, tall>;
    var link_x: array<vec4f, tall>;
    var link_y: array<vec4f, tall>;
    var flow_x: array<vec4f, tall>;
    var flow_y: array<vec4f, tall>;
    var target_u: array<vec4f, tall>;
    let corner = vec2i(group.xy * (vec2u(64u, 16u * tall) - 2u * steps) + vec2u(4u, tall) * local.xy) - i32(steps);
    for (var y = 0u; y < tall; y++) {
        for (var x = 0u; x < 4u; x++) {
            let at = corner + vec2i(i32(x), i32(y));
            var state = vec4f();
            if (is_inside(at)) {
                let pixel = u32(at.y) * width + u32(at.x);
                state = before[pixel];
                target_u[y][x] = goal[pixel];
                // No link beyond the last column and row: the gradient is 0 there.
                let link = links[pixel] * vec2f(f32(at.x + 1i < i32(width)), f32(at.y + 1i < i32(height)));
                link_x[y][x] = link.x;
                link_y[y][x] = link.y;
            }
            u[y][x] = state.x;
            ahead[y][x] = select(state.y, state.x, is_fresh);
            dual_x[y][x] = state.z;
            dual_y[y][x] = state.w;
        }
        first_column[number * tall + y] = ahead[y].x;
    }
    first_row[number] = ahead[0];
    workgroupBarrier();
    let right = min(number + 1u, 255u) * tall;
    let left = (max(number, 1u) - 1u) * tall;
    let below = min(number + 16u, 255u);
    let above = max(number, 16u) - 16u;
    let pull = primal_step * weight;
    let damping = 1.0 / (1.0 + dual_step * huber);
    let share = 1.0 / (1.0 + pull);
    for (var n = 0u; n < steps; n++) {
        for (var y = 0u; y < tall; y++) {
            let here = ahead[y];
            let beside = vec4f(here.yzw, first_column[right + y]);
            var under: vec4f;
            if (y + 1u < tall) { under = ahead[y + 1u]; } else { under = first_row[below]; }
            // Links are 0 outside of the picture, where the dual stays 0.
            let along = (dual_x[y] + dual_step * link_x[y] * (beside - here)) * damping;
            let down = (dual_y[y] + dual_step * link_y[y] * (under - here)) * damping;
            let shorter = inverseSqrt(max(vec4f(1.0), along * along + down * down));
            dual_x[y] = along * shorter;
            dual_y[y] = down * shorter;
            flow_x[y] = dual_x[y] * link_x[y];
            flow_y[y] = dual_y[y] * link_y[y];
            last_column[number * tall + y] = flow_x[y].w;
        }
        last_row[number] = flow_y[tall - 1u];
        workgroupBarrier();
        for (var y = 0u; y < tall; y++) {
            let beside = vec4f(select(last_column[left + y], 0.0, local.x == 0u), flow_x[y].xyz);
            var over: vec4f;
            if (y > 0u) { over = flow_y[y - 1u]; } else { over = select(last_row[above], vec4f(), local.y == 0u); }
            let divergence = flow_x[y] - beside + flow_y[y] - over;
            let next = clamp((u[y] + primal_step * divergence + pull * target_u[y]) * share, vec4f(), vec4f(highest));
            ahead[y] = next + (next - u[y]);
            u[y] = next;
            first_column[number * tall + y] = ahead[y].x;
        }
        first_row[number] = ahead[0];
        workgroupBarrier();
    }
    for (var y = 0u; y < tall; y++) {
        for (var x = 0u; x < 4u; x++) {
            let slot = vec2u(4u, tall) * local.xy + vec2u(x, y);
            let at = corner + vec2i(i32(x), i32(y));
            let kept = all(slot >= vec2u(steps)) && all(slot < vec2u(64u, 16u * tall) - steps);
            if (kept && is_inside(at)) {
                after[u32(at.y) * width + u32(at.x)] = vec4f(u[y][x], ahead[y][x], dual_x[y][x], dual_y[y][x]);
            }
        }
    }
}
