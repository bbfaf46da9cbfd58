// One plane through the core blocks of a part, or of two parts together; see `plane_merging.py`.

struct Fit {
    plane: vec3f,
    value: f32,
}

const numbers_of_plane = 3.0;  // slope along x and y, and the label

var<private> lists: vec2u;  // 1 + first segment of both parts, 0 for no second part
var<private> every: u32;  // so manyth point counts

fn sums_of(plane: vec3f, middle: vec2f, local: u32) -> Sums {
    var own = Sums();
    var before = 0u;  // points of the segments before
    for (var side = 0u; side < 2u; side++) {
        var next = lists[side];
        while (next != 0u) {
            let segment = segments[next - 1u];
            let end = before + segment.points;
            for (var k = (before + every - 1u) / every + local; k * every < end; k += lanes) {
                let packed = points[segment.start + k * every - before];
                own = added(own, of_point(plane, vec2u(packed & 0xffffu, packed >> 16u), middle));
            }
            before = end;
            next = segment.next;
        }
    }
    return total(own, local);
}

// Log-likelihood of all points, less what the plane costs besides.
fn log_likelihood(plane: vec3f, middle: vec2f, number: u32, local: u32) -> f32 {
    var own = 0.0;
    for (var side = 0u; side < 2u; side++) {
        var next = lists[side];
        while (next != 0u) {
            let segment = segments[next - 1u];
            for (var k = local; k < segment.points; k += lanes) {
                let packed = points[segment.start + k];
                let pixel = vec2u(packed & 0xffffu, packed >> 16u);
                let place = dot(plane, vec3f(vec2f(pixel) - middle, 1.0));
                let below = u32(clamp(place, 0.0, f32(count - 2u)));
                let value = between((pixel.y * width + pixel.x) * count, below, place - f32(below));
                own += select(-outside, value, place >= 0.0 && place <= f32(count - 1u));
            }
            next = segment.next;
        }
    }
    let all = total(Sums(own, vec3f(), vec3f(), vec3f()), local).value;
    return all - 0.5 * slope_penalty * f32(number) * dot(plane.xy, plane.xy);
}

// The plane that `start` leads to, of the points of `lists`, `number` in all.
fn fitted(start: vec3f, middle: vec2f, number: u32, steps: u32, even: bool, local: u32) -> Fit {
    every = max(1u, (number + most_points - 1u) / most_points);
    let counted = f32((number + every - 1u) / every);
    let plane = climbed(start, middle, slope_penalty * counted, steps, even, local).xyz;
    let value = log_likelihood(plane, middle, number, local);
    workgroupBarrier();  // all have read the sum before another is formed
    return Fit(plane, value);
}

// The plane of one label where it is nearly as likely, in place of the plane; and how many numbers it takes.
fn simplest_of(found: Fit, middle: vec2f, number: u32, local: u32) -> vec4f {
    let level = fitted(vec3f(0.0, 0.0, found.plane.z), middle, number, newton_steps, true, local);
    let is_even = found.value - level.value <= slope_tolerance * found.value;
    let plane = select(found.plane, level.plane, is_even);
    return vec4f(plane, select(numbers_of_plane, 1.0, all(plane.xy == vec2f())));
}
