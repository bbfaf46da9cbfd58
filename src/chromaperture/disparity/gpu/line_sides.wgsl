// What the picture tells of a line: its light, the power of its ends, its noise; and how squarely it crosses its border.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> lines: array<vec2u>;  // grid point, and the sides' key
@group(0) @binding(2) var<storage, read> numbers: array<u32>;  // of lines
@group(0) @binding(3) var<storage, read> smooth_light: array<f32>;  // (h, w, 3)
@group(0) @binding(4) var<storage, read> noise: array<f32>;  // (h, w, 3): variance
@group(0) @binding(5) var<storage, read> taps: array<vec2f>;  // (2 reach + 1,): slope of a Gaussian, and along it
@group(0) @binding(6) var<storage, read_write> about: array<vec4u>;  // near and far plane, points and order, weight
@group(0) @binding(7) var<storage, read_write> facts: array<Line>;

// Squared cosine between the line and the normal of its near plane's border, see `plane_edges._across`.
fn across(point: u32, near: u32, down: bool) -> f32 {
    var slope = vec2f();
    for (var v = 0u; v <= 2u * reach; v++) {
        let y = mirrored(i32(point / width + v) - i32(reach), height);
        var sums = vec2f();
        for (var u = 0u; u <= 2u * reach; u++) {
            let x = mirrored(i32(point % width + u) - i32(reach), width);
            sums += select(vec2f(), taps[u], choice[y * width + x] == near);
        }
        slope += sums * taps[v].yx;
    }
    let squares = slope * slope;
    return select(squares.x, squares.y, down) / (squares.x + squares.y + 1.0e-30);
}

// Sum of the squared deviations from their mean of some samples of all channels.
fn energy(first: u32, stride: u32) -> f32 {
    var sum = vec3f();
    var squares = vec3f();
    let from_here = light_at(first);  // deviations from it: small numbers
    for (var k = 1u; k < outer; k++) {
        let deviation = light_at(first + k * stride) - from_here;
        sum += deviation;
        squares += deviation * deviation;
    }
    return dot(squares - sum * sum / f32(outer), vec3f(1.0));
}

fn light_at(point: u32) -> vec3f {
    return vec3f(smooth_light[3u * point], smooth_light[3u * point + 1u], smooth_light[3u * point + 2u]);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= numbers[0]) { return; }
    let down = lines[i].x >= width * height;
    let point = select(lines[i].x, lines[i].x - width * height, down);
    let stride = select(1u, width, down);
    let first = point - (half - 1u) * stride;
    var light = vec3f();
    for (var k = 0u; k < 2u * half; k++) { light += light_at(first + k * stride); }
    let cosine = across(point, about[i].x, down);
    let is_heard = cosine > least_across;
    about[i].w = bitcast<u32>(line_weight * cosine);
    if (!is_heard) { about[i].z = 0u; }  // no point of it counts
    let ends = vec2f(energy(first, stride), energy(first + (2u * half - outer) * stride, stride));
    facts[i] = Line(
        vec3f(noise[3u * point], noise[3u * point + 1u], noise[3u * point + 2u]), dot(light, vec3f(1.0)) / f32(6u * half),
        ends, select(unheard, lines[i].y, is_heard)
    );
}
