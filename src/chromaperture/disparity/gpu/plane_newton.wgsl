// Newton's method with shortened steps on a plane's log-likelihood; see `stages/plane_refining.py`. A workgroup has one
// plane and its points, the stage says which: `sums_of` adds what its own points say, and returns the `total`. Planes
// count in layers, from the middle of their points.

struct Sums {
    value: f32,
    gradient: vec3f,
    diagonal: vec3f,
    mixed: vec3f,  // ab, ac, bc
}

var<workgroup> sums: array<Sums, lanes>;
var<workgroup> trial: vec3f;
var<workgroup> is_done: u32;

fn added(a: Sums, b: Sums) -> Sums {
    return Sums(a.value + b.value, a.gradient + b.gradient, a.diagonal + b.diagonal, a.mixed + b.mixed);
}

// Sum of what all invocations have.
fn total(own: Sums, local: u32) -> Sums {
    sums[local] = own;
    workgroupBarrier();
    for (var half = lanes / 2u; half > 0u; half /= 2u) {
        if (local < half) { sums[local] = added(sums[local], sums[local + half]); }
        workgroupBarrier();
    }
    return sums[0];
}

// Log-likelihood at a place between two labels of a pixel, whose first label lies at `first`.
fn between(first: u32, below: u32, t: f32) -> f32 {
    return mix(likelihood[first + below], likelihood[first + below + 1u], t);
}

// What a point says of a plane: nothing too close to an end of the range.
fn of_point(plane: vec3f, pixel: vec2u, middle: vec2f) -> Sums {
    let terms = vec3f(vec2f(pixel) - middle, 1.0);
    let place = dot(plane, terms);
    if (place < f32(reach) || place >= f32(count - 1u - reach)) { return Sums(); }
    let below = u32(place);
    let t = place - f32(below);
    let first = (pixel.y * width + pixel.x) * count;
    let here = between(first, below, t);
    let before = between(first, below - reach, t);
    let behind = between(first, below + reach, t);
    let slope = (behind - before) / f32(2u * reach);
    let bend = (behind + before - 2.0 * here) / f32(reach * reach);
    return Sums(here, slope * terms, bend * terms * terms, bend * vec3f(terms.x * terms.y, terms.x, terms.y));
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
    size = max(size, vec3f(condition * max(max(max(size.x, size.y), size.z), least_bend)));
    return axes * ((transpose(axes) * uphill) / size);
}

// The plane that a plane leads to in at most `steps` steps, the same for all invocations; `even` keeps its slopes.
fn climbed(start: vec3f, middle: vec2f, slope_bend: f32, steps: u32, even: bool, local: u32) -> vec4f {
    var plane = start;
    if (local == 0u) { trial = plane; }
    var best: Sums;  // of `plane`; only the first invocation decides
    var value = 0.0;
    var before = 0.0;
    var move_by = vec3f();
    var shorter = 0u;
    var steps_taken = 0u;
    for (var evaluation = 0u; evaluation <= 3u * steps; evaluation++) {
        let here = workgroupUniformLoad(&trial);
        let found = sums_of(here, middle, local);
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
                    if (steps_taken == steps || value - before <= gained * abs(value)) { is_done = 1u; }
                }
                before = value;
                shorter = 0u;
                if (even) {
                    move_by = vec3f(0.0, 0.0, best.gradient.z / max(-best.diagonal.z, least_bend));
                } else {
                    move_by = newton(plane, best, slope_bend);
                }
            }
            trial = plane + move_by * select(select(0.25, 0.5, shorter == 1u), 1.0, shorter == 0u);
        }
        if (workgroupUniformLoad(&is_done) == 1u) { break; }
    }
    if (local == 0u) { trial = plane; }
    return vec4f(workgroupUniformLoad(&trial), value);  // the value is the first invocation's
}
