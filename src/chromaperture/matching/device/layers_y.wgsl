// The windows of `layers_x.wgsl` joined along y in the same way, and the scores of their layers; `keep` leaves them.

@group(0) @binding(0) var<storage, read> windows: array<vec4f>;  // (h + 2 pad_y, w, Q, K + moments)
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read_write> incoming: array<vec4f>;  // (groups, blocks, K + moments, 8)

fn window_at(column: u32, y: i32) -> Moments {
    let at = (inside(y + i32(pad_y), height + 2u * pad_y) * width * quads + column) * moment_pitch;
    var found: Moments;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        found.means[k] = windows[at + k];
    }
    for (var m = 0u; m < moment_count; m++) {  // unrolled
        found.spreads[m] = windows[at + view_count + m];
    }
    return found;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * quads) { return; }
    let quad = i % quads;
    let begin = -i32((pad_y + each - 1u) / each * each);
    let own = (i - i % 8u) * blocks * moment_pitch + i % 8u;
    var state = window_at(i, begin);
    var here: Moments;
    for (var block = 0u; block < blocks; block++) {
        let to = own + 8u * block * moment_pitch;
        for (var k = 0u; k < view_count; k++) {  // unrolled
            incoming[to + 8u * k] = state.means[k];
        }
        for (var m = 0u; m < moment_count; m++) {  // unrolled
            incoming[to + 8u * (view_count + m)] = state.spreads[m];
        }
        for (var n = 0u; n < each; n++) {  // unrolled
            here = window_at(i, begin + i32(block * each + n));
            state = joined(state, here);
        }
    }

    state = begun_behind(state, here);
    var floors: array<f32, view_count>;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        floors[k] = relative_epsilon * stats[VARIANCE + k] + 1.0e-30;
    }
    for (var block = blocks; block > 0u; block--) {
        let first = begin + i32((block - 1u) * each);
        let from_ = own + 8u * (block - 1u) * moment_pitch;
        var states: array<Moments, each + 1u>;
        for (var k = 0u; k < view_count; k++) {  // unrolled
            states[0].means[k] = incoming[from_ + 8u * k];
        }
        for (var m = 0u; m < moment_count; m++) {  // unrolled
            states[0].spreads[m] = incoming[from_ + 8u * (view_count + m)];
        }
        for (var n = 0u; n < each; n++) {  // unrolled
            states[n + 1u] = joined(states[n], window_at(i, first + i32(n)));
        }
        for (var n = 0u; n < each; n++) {  // unrolled
            state = joined(state, states[each - n]);
            let y = first + i32(each - 1u - n);
            if (y >= 0i && y < i32(height)) {
                var gains: array<vec4f, view_count>;
                for (var k = 0u; k < view_count; k++) {  // unrolled
                    gains[k] = inverseSqrt(state.spreads[k] + floors[k]);
                }
                keep(u32(y) * width + i / quads, quad, score_of(state.spreads, gains));
            }
        }
    }
}
