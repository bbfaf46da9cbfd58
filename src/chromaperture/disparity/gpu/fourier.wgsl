// Fourier transforms of lines of `span` complex numbers, at most 1024, in shared memory: Stockham's, of radices 2, 3, 4, 5,
// 6 and 8.
// A workgroup of 128 transforms as many lines as fit, an even number. Factors come from a table, because
// sine and cosine of a shader are good to 2^-11 only.

@group(0) @binding(0) var<storage, read> factors: array<vec2f>;  // (span,): exp(-2 pi i k / span)

const lines_of_group = 1024u / span;

var<workgroup> line: array<vec2f, 2048>;  // before and after a pass

fn product(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

// Times -i, or i backwards.
fn turned(a: vec2f) -> vec2f {
    return select(vec2f(a.y, -a.x), vec2f(-a.y, a.x), backwards);
}

fn factor(k: u32) -> vec2f {
    let f = factors[k];
    return vec2f(f.x, select(f.y, -f.y, backwards));
}

// Radices of the passes, four bits each, and how many numbers are done before each pass. They are constants, so that
// every pass is compiled for itself: its divisions become multiplications.
const r0 = radices & 15u;
const r1 = (radices >> 4u) & 15u;
const r2 = (radices >> 8u) & 15u;
const r3 = (radices >> 12u) & 15u;
const r4 = (radices >> 16u) & 15u;
const r5 = (radices >> 20u) & 15u;
const d2 = r0 * r1;
const d3 = d2 * r2;
const d4 = d3 * r3;
const d5 = d4 * r4;

// Transforms what lies at the places 0, 1, ... of `line`; returns where the result begins. Not divided by `span`.
fn transformed(local: u32) -> u32 {
    one_pass(r0, 1u, 0u, local);
    if (passes > 1u) { one_pass(r1, r0, 1024u, local); }
    if (passes > 2u) { one_pass(r2, d2, 0u, local); }
    if (passes > 3u) { one_pass(r3, d3, 1024u, local); }
    if (passes > 4u) { one_pass(r4, d4, 0u, local); }
    if (passes > 5u) { one_pass(r5, d5, 1024u, local); }
    workgroupBarrier();
    return (passes & 1u) * 1024u;
}

const sin60 = 0.8660254f;  // of a third of a turn, too
const sin45 = 0.70710678f;

struct Thirds { a: vec2f, b: vec2f, c: vec2f }
struct Fourths { a: vec2f, b: vec2f, c: vec2f, d: vec2f }

fn of_three(a: vec2f, b: vec2f, c: vec2f) -> Thirds {
    let sum = b + c;
    let away = turned(b - c) * sin60;
    return Thirds(a + sum, a - 0.5 * sum + away, a - 0.5 * sum - away);
}

fn of_four(a: vec2f, b: vec2f, c: vec2f, d: vec2f) -> Fourths {
    let away = turned(b - d);
    return Fourths(a + c + b + d, a - c + away, a + c - b - d, a - c - away);
}

// A number that a pass begins with, times its factor; factors of the first pass are 1.
fn taken(at: u32, k: u32, done: u32) -> vec2f {
    if (done == 1u) { return line[at]; }
    return product(line[at], factor(k));
}

fn one_pass(radix: u32, done: u32, start: u32, local: u32) {
    let part = span / radix;
    workgroupBarrier();
    for (var i = local; i < lines_of_group * part; i += 128u) {
        let first = i / part * span;
        let j = i % part;
        let k = j % done;
        let step = part / done * k;
        let at = start + first + j;
        let to = 1024u - start + first + (j - k) * radix + k;
        let a = line[at];
        let b = taken(at + part, step, done);
        if (radix == 2u) {
            line[to] = a + b;
            line[to + done] = a - b;
            continue;
        }
        let c = taken(at + 2u * part, 2u * step, done);
        if (radix == 3u) {
            let three = of_three(a, b, c);
            line[to] = three.a;
            line[to + done] = three.b;
            line[to + 2u * done] = three.c;
            continue;
        }
        let d = taken(at + 3u * part, 3u * step, done);
        if (radix == 4u) {
            let four = of_four(a, b, c, d);
            line[to] = four.a;
            line[to + done] = four.b;
            line[to + 2u * done] = four.c;
            line[to + 3u * done] = four.d;
            continue;
        }
        let e = taken(at + 4u * part, 4u * step, done);
        if (radix == 5u) {
            // Cosines and sines of a fifth and two fifths of a turn.
            let outer = b + e;
            let inner = c + d;
            let near = a + 0.30901699 * outer - 0.80901699 * inner;
            let far = a - 0.80901699 * outer + 0.30901699 * inner;
            let near_away = turned(0.95105652 * (b - e) + 0.58778525 * (c - d));
            let far_away = turned(0.58778525 * (b - e) - 0.95105652 * (c - d));
            line[to] = a + outer + inner;
            line[to + done] = near + near_away;
            line[to + 2u * done] = far + far_away;
            line[to + 3u * done] = far - far_away;
            line[to + 4u * done] = near - near_away;
            continue;
        }
        let f = taken(at + 5u * part, 5u * step, done);
        if (radix == 6u) {
            let even = of_three(a + d, b + e, c + f);
            let second = b - e;
            let third = c - f;
            let odd = of_three(a - d, 0.5 * second + sin60 * turned(second), sin60 * turned(third) - 0.5 * third);
            line[to] = even.a;
            line[to + done] = odd.a;
            line[to + 2u * done] = even.b;
            line[to + 3u * done] = odd.b;
            line[to + 4u * done] = even.c;
            line[to + 5u * done] = odd.c;
            continue;
        }
        let g = taken(at + 6u * part, 6u * step, done);
        let h = taken(at + 7u * part, 7u * step, done);
        let even = of_four(a + e, b + f, c + g, d + h);
        let second = b - f;
        let fourth = d - h;
        let odd = of_four(a - e, sin45 * (second + turned(second)), turned(c - g), sin45 * (turned(fourth) - fourth));
        line[to] = even.a;
        line[to + done] = odd.a;
        line[to + 2u * done] = even.b;
        line[to + 3u * done] = odd.b;
        line[to + 4u * done] = even.c;
        line[to + 5u * done] = odd.c;
        line[to + 6u * done] = even.d;
        line[to + 7u * done] = odd.d;
    }
}
