// Moves planes to the most likely place near them, by Newton's method with shortened steps; see `plane_fit.py`. A
// workgroup has one plane and its points. Planes count in layers, from the middle of their points.

@group(0) @binding(0) var<storage, read> likelihood: array<f32>;  // (h, w, count)
@group(0) @binding(1) var<storage, read> points: array<u32>;  // x and y, 16 bits each
@group(0) @binding(2) var<storage, read> parts: array<vec4u>;  // (planes,): first point, points; their middle as bits
@group(0) @binding(3) var<storage, read_write> planes: array<vec4f>;  // (planes,)

struct Sums {
    value: f32,
    gradient: vec3f,
    diagonal: vec3f,
    mixed: vec3f,  // ab, ac, bc
}

var<workgroup> sums: array<Sums, 64>;
var<workgroup> trial: vec3f;
var<workgroup> is_done: u32;

fn added(a: Sums, b: Sums) -> Sums {
    return Sums(a.value + b.value, a.gradient + b.gradient, a.diagonal + b.diagonal, a.mixed + b.mixed);
}

// Log-likelihood at a place between two labels of a pixel.
fn between(first: u32, below: u32, t: f32) -> f32 {
    return mix(likelihood[first + below], likelihood[first + below + 1u], t);
}

fn sums_of(plane: vec3f, part: vec4u, middle: vec2f, local: u32) -> Sums {
    var own = Sums();
    for (var i = local; i < part.y; i += 64u) {
        let packed = points[part.x + i];
        let pixel = vec2u(packed & 0xffffu, packed >> 16u);
        let terms = vec3f(vec2f(pixel) - middle, 1.0);
        let place = dot(plane, terms);
        if (place >= f32(reach) && place < f32(count - 1u - reach)) {
            let below = u32(place);
            let t = place - f32(below);
            let first = (pixel.y * width + pixel.x) * count;
            let here = between(first, below, t);
            let before = between(first, below - reach, t);
            let behind = between(first, below + reach, t);
            let slope = (behind - before) / f32(2u * reach);
            let bend = (behind + before - 2.0 * here) / f32(reach * reach);
            own.value += here;
            own.gradient += slope * terms;
            own.diagonal += bend * terms * terms;
            own.mixed += bend * vec3f(terms.x * terms.y, terms.x, terms.y);
        }
    }
    sums[local] = own;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { sums[local] = added(sums[local], sums[local + half]); }
        workgroupBarrier();
    }
    return sums[0];
}

// Newton's step: Jacobi's eigenvalues of the curvature, the small ones raised.
fn newton(plane: vec3f, found: Sums, slope_bend: f32) -> vec3f {
    let uphill = found.gradient - slope_bend * vec3f(plane.xy, 0.0);
    var m = mat3x3f(
        vec3f(slope_bend - found.diagonal.x, -found.mixed.x, -found.mixed.y),
        vec3f(-found.mixed.x, slope_bend - found.diagonal.y, -found.mixed.z),
        vec3f(-found.mixed.y, -found.mixed.z, -found.diagonal.z),
    );
    var axes = mat3x3f(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), vec3f(0.0, 0.0, 1.0));
    for (var sweep = 0u; sweep < 6u; sweep++) {
        for (var r = 0u; r < 3u; r++) {
            let p = select(0u, 1u, r == 2u);
            let q = select(2u, 1u, r == 0u);
            if (abs(m[p][q]) < 1.0e-30) { continue; }
            let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
            var t = 1.0 / (abs(theta) + sqrt(theta * theta + 1.0));
            t = select(-t, t, theta >= 0.0);
            let c = inverseSqrt(t * t + 1.0);
            let s = t * c;
            var turn = mat3x3f(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), vec3f(0.0, 0.0, 1.0));
            turn[p][p] = c;
            turn[q][q] = c;
            turn[p][q] = -s;
            turn[q][p] = s;
            m = transpose(turn) * m * turn;
            axes = axes * turn;
        }
    }
    var size = vec3f(m[0][0], m[1][1], m[2][2]);
    size = max(size, vec3f(condition * max(max(max(size.x, size.y), size.z), 1.0e-9)));
    return axes * ((transpose(axes) * uphill) / size);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let part = parts[group.x];
    if (part.y == 0u) { return; }
    let middle = bitcast<vec2f>(part.zw);
    let slope_bend = slope_penalty * f32(part.y);
    var plane = planes[group.x].xyz;
    if (local == 0u) { trial = plane; }
    var best: Sums;  // of `plane`; only the first invocation decides
    var value = 0.0;
    var before = 0.0;
    var move_by = vec3f();
    var shorter = 0u;
    var steps_taken = 0u;
    for (var evaluation = 0u; evaluation <= 3u * newton_steps; evaluation++) {
        let here = workgroupUniformLoad(&trial);
        let found = sums_of(here, part, middle, local);
        if (local == 0u) {
            let earned = found.value - 0.5 * slope_bend * dot(here.xy, here.xy);
            var is_over = evaluation == 0u;
            if (evaluation == 0u || earned > value) {
                best = found;
                value = earned;
                plane = here;
                is_over = true;
            } else {
                shorter++;
                is_over = shorter == 3u;
            }
            is_done = 0u;
            if (is_over) {
                if (evaluation > 0u) {
                    steps_taken++;
                    if (steps_taken == newton_steps || value - before <= gained * abs(value)) { is_done = 1u; }
                }
                before = value;
                shorter = 0u;
                move_by = newton(plane, best, slope_bend);
            }
            trial = plane + move_by * select(select(0.25, 0.5, shorter == 1u), 1.0, shorter == 0u);
        }
        if (workgroupUniformLoad(&is_done) == 1u) { break; }
    }
    if (local == 0u) { planes[group.x] = vec4f(plane, value); }
}
