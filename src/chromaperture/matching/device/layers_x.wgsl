// Samples of four layers along x, and the moments of their window along x, for rasterisers in software and layers that
// share no samples. An invocation takes a whole row. The walk to its end leaves what comes into every `each`-th sample,
// the walk back has what is between in registers: 4 numbers a score are read in each, and 9 are written (three views),
// in place of the 29 of `sample_x.wgsl`, `windows_x.wgsl` and `products_x.wgsl`.

@group(0) @binding(0) var<storage, read> rows: array<f32>;  // (h + 2 pad_y, w, Ey)
@group(0) @binding(1) var<storage, read> phases: array<vec4f>;  // (E, 2): four taps; the phase along y
@group(0) @binding(2) var<storage, read> places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
@group(0) @binding(3) var<storage, read_write> incoming: array<vec4f>;  // (groups, blocks, K + moments, 8)
@group(0) @binding(4) var<storage, read_write> windows: array<vec4f>;  // (h + 2 pad_y, w, Q, K + moments)

struct Way {
    starts: array<vec4i, view_count>,  // of the rows that the layers read
    shifts: array<vec4i, view_count>,
    taps: array<array<vec4f, 4>, view_count>,  // of the layers, tap after tap
}

// What the layers read of a view at a place of theirs.
fn raw(start: vec4i, place: vec4i) -> vec4f {
    let at = start + clamp(place, vec4i(), vec4i(i32(width) - 1i)) * i32(phase_count);
    return vec4f(rows[at.x], rows[at.y], rows[at.z], rows[at.w]);
}

fn sampled(taps: array<vec4f, 4>, a: vec4f, b: vec4f, c: vec4f, d: vec4f) -> vec4f {
    return taps[0] * a + taps[1] * b + taps[2] * c + taps[3] * d;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let tall = height + 2u * pad_y;
    if (i >= tall * quads) { return; }
    let quad = i % quads;
    let row = i / quads;
    var way: Way;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        for (var j = 0u; j < 4u; j++) {  // unrolled
            let place = places[4u * (k * quads + quad) + j];
            let taps = phases[2 * place.x];
            let phase = i32(phases[2 * place.x + 1].x);
            way.starts[k][j] = i32(inside(i32(row) + place.z, tall) * width * phase_count) + phase;
            way.shifts[k][j] = place.y;
            way.taps[k][0][j] = taps.x;
            way.taps[k][1][j] = taps.y;
            way.taps[k][2][j] = taps.z;
            way.taps[k][3][j] = taps.w;
        }
    }
    let begin = -i32((pad_x + each - 1u) / each * each);
    let own = (i - i % 8u) * blocks * moment_pitch + i % 8u;

    var before: array<vec4f, view_count>;  // what was read last, and before that
    var second: array<vec4f, view_count>;
    var third: array<vec4f, view_count>;
    var state: Moments;
    var here: Moments;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        third[k] = raw(way.starts[k], way.shifts[k] + begin - 1i);
        second[k] = raw(way.starts[k], way.shifts[k] + begin);
        before[k] = raw(way.starts[k], way.shifts[k] + begin + 1i);
        state.means[k] = third[k];  // all is even here
    }
    for (var block = 0u; block < blocks; block++) {
        let to = own + 8u * block * moment_pitch;
        for (var k = 0u; k < view_count; k++) {  // unrolled
            incoming[to + 8u * k] = state.means[k];
        }
        for (var m = 0u; m < moment_count; m++) {  // unrolled
            incoming[to + 8u * (view_count + m)] = state.spreads[m];
        }
        for (var n = 0u; n < each; n++) {  // unrolled
            let x = begin + i32(block * each + n);
            for (var k = 0u; k < view_count; k++) {  // unrolled
                let read = raw(way.starts[k], way.shifts[k] + x + 2i);
                here.means[k] = sampled(way.taps[k], third[k], second[k], before[k], read);
                third[k] = second[k];
                second[k] = before[k];
                before[k] = read;
            }
            state = joined(state, here);
        }
    }

    state = begun_behind(state, here);
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
        var read: array<array<vec4f, each + 3u>, view_count>;
        for (var k = 0u; k < view_count; k++) {  // unrolled
            for (var n = 0u; n < each; n++) {  // unrolled
                read[k][n] = raw(way.starts[k], way.shifts[k] + first - 1i + i32(n));
            }
            read[k][each] = third[k];
            read[k][each + 1u] = second[k];
            read[k][each + 2u] = before[k];
            third[k] = read[k][0];
            second[k] = read[k][1];
            before[k] = read[k][2];
        }
        for (var n = 0u; n < each; n++) {  // unrolled
            var sample: Moments;
            for (var k = 0u; k < view_count; k++) {  // unrolled
                sample.means[k] = sampled(way.taps[k], read[k][n], read[k][n + 1u], read[k][n + 2u], read[k][n + 3u]);
            }
            states[n + 1u] = joined(states[n], sample);
        }
        for (var n = 0u; n < each; n++) {  // unrolled
            state = joined(state, states[each - n]);
            let x = first + i32(each - 1u - n);
            if (x >= 0i && x < i32(width)) {
                let to = ((row * width + u32(x)) * quads + quad) * moment_pitch;
                for (var k = 0u; k < view_count; k++) {  // unrolled
                    windows[to + k] = state.means[k];
                }
                for (var m = 0u; m < moment_count; m++) {  // unrolled
                    windows[to + view_count + m] = state.spreads[m];
                }
            }
        }
    }
}
