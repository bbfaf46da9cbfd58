// Fourier transforms of lines of `span` complex numbers, at most 1024, in shared memory: Stockham's, of radices 2 to 5.
// A workgroup of 128 transforms as many lines as fit. Factors come from a table, because sine and cosine of a shader
// are good to 2^-11 only.

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

// Radices of the passes, three bits each, and how many numbers are done before each pass. They are constants, so that
// every pass is compiled for itself: its divisions become multiplications.
const r0 = radices & 7u;
const r1 = (radices >> 3u) & 7u;
const r2 = (radices >> 6u) & 7u;
const r3 = (radices >> 9u) & 7u;
const r4 = (radices >> 12u) & 7u;
const r5 = (radices >> 15u) & 7u;
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
        let b = product(line[at + part], factor(step));
        if (radix == 2u) {
            line[to] = a + b;
            line[to + done] = a - b;
            continue;
        }
        let c = product(line[at + 2u * part], factor(2u * step));
        if (radix == 3u) {
            let sum = b + c;
            let away = turned(b - c) * 0.8660254;  // sine of a third of a turn
            line[to] = a + sum;
            line[to + done] = a - 0.5 * sum + away;
            line[to + 2u * done] = a - 0.5 * sum - away;
            continue;
        }
        let d = product(line[at + 3u * part], factor(3u * step));
        if (radix == 4u) {
            let away = turned(b - d);
            line[to] = a + c + b + d;
            line[to + done] = a - c + away;
            line[to + 2u * done] = a + c - b - d;
            line[to + 3u * done] = a - c - away;
            continue;
        }
        // Cosines and sines of a fifth and two fifths of a turn.
        let e = product(line[at + 4u * part], factor(4u * step));
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
    }
}
