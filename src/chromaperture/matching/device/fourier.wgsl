// Transforms of lines, and the tiles that they are taken of.

// ---- fourier
// Fourier transforms of lines of `span` complex numbers, at most 1024: Stockham's, of radices 2 to 16. An entry is a vector
// of two numbers, of two lines that go side by side. A stage has two functions of its own:
//     fn taken(line: u32, place: u32) -> vec4f          an entry of a line before
//     fn given(line: u32, place: u32, value: vec4f)     an entry of its transform, not divided by `span`
// The first pass reads what is taken, the last one gives; what lies between goes through shared memory. An invocation has
// one butterfly of a pass. Factors come from a table, because sine and cosine of a shader are good to 2^-11 only.

in factors: array<vec2f>;  // (span,): exp(-2 pi i k / span)

var<workgroup> shared_line: array<vec4f, lines_of_group * span>;

// Radices of the passes, eight bits each, and how many numbers are done before each pass. They are constants, so that
// every pass is compiled for itself: its divisions become multiplications.
const r0 = radices & 255u;
const r1 = (radices >> 8u) & 255u;
const r2 = (radices >> 16u) & 255u;  // of the last one `last_radix`

// An invocation's butterfly: its line among those of the workgroup, its place there.
struct Butterfly { line: u32, place: u32, is_used: bool }

fn butterfly_of(local: u32, radix: u32) -> Butterfly {
    let part = span / radix;
    // Neighbouring invocations have neighbouring numbers of what is taken and given.
    let by_line = select(local / part, local % lines_of_group, beside_lines);
    let place = select(local % part, local / lines_of_group, beside_lines);
    return Butterfly(by_line, place, local < lines_of_group * part);
}

// Transforms `lines_of_group` lines from `first` on; every invocation of the workgroup calls it.
fn transform(first: u32, local: u32) {
    var values: array<vec4f, 16>;
    let begin = butterfly_of(local, r0);
    if (begin.is_used && first + begin.line < lines) {
        for (var m = 0u; m < r0; m++) { values[m] = taken(first + begin.line, begin.place + span / r0 * m); }
        turn_all(&values, r0);
        for (var m = 0u; m < r0; m++) { shared_line[begin.line * span + begin.place * r0 + m] = values[m]; }
    }
    if (passes > 2u) { middle_pass(r1, r0, local); }
    if (passes > 3u) { middle_pass(r2, r0 * r1, local); }
    workgroupBarrier();
    let done = span / last_radix;
    let end = butterfly_of(local, last_radix);
    if (end.is_used && first + end.line < lines) {
        read_turned(&values, last_radix, done, end);
        for (var m = 0u; m < last_radix; m++) { given(first + end.line, end.place + done * m, values[m]); }
    }
}

// All read before any writes: one list of numbers is enough.
fn middle_pass(radix: u32, done: u32, local: u32) {
    var values: array<vec4f, 16>;
    workgroupBarrier();
    let own = butterfly_of(local, radix);
    if (own.is_used) { read_turned(&values, radix, done, own); }
    workgroupBarrier();
    let k = own.place % done;
    if (own.is_used) {
        for (var m = 0u; m < radix; m++) {
            shared_line[own.line * span + (own.place - k) * radix + k + done * m] = values[m];
        }
    }
}

// Reads the numbers of a butterfly, times their factors, and transforms them.
fn read_turned(values: ptr<function, array<vec4f, 16>>, radix: u32, done: u32, own: Butterfly) {
    let part = span / radix;
    let at = own.line * span + own.place;
    let one = factor(part / done * (own.place % done));
    let two = square(one);
    let three = times(two, one);
    let four = square(two);
    let eight = square(four);
    let twelve = times(eight, four);
    (*values)[0] = shared_line[at];
    for (var m = 1u; m < radix; m++) {
        let high = select(select(twelve, eight, m < 12u), four, m < 8u);
        let low = select(select(three, two, m % 4u == 2u), one, m % 4u == 1u);
        let turn = select(select(times(high, low), low, m < 4u), high, m % 4u == 0u);
        (*values)[m] = product(shared_line[at + part * m], turn);
    }
    turn_all(values, radix);
}

fn factor(k: u32) -> vec2f {
    let f = factors[k];
    return vec2f(f.x, select(f.y, -f.y, backwards));
}

fn times(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

fn square(a: vec2f) -> vec2f {
    return times(a, a);
}

fn product(a: vec4f, b: vec2f) -> vec4f {
    return a * b.x + vec4f(-a.y, a.x, -a.w, a.z) * b.y;
}

// Times -i, or i backwards.
fn turned(a: vec4f) -> vec4f {
    return select(vec4f(a.y, -a.x, a.w, -a.z), vec4f(-a.y, a.x, -a.w, a.z), backwards);
}

// Times exp(-i angle), or exp(i angle) backwards.
fn turned_by(a: vec4f, cosine: f32, sine: f32) -> vec4f {
    return a * cosine + turned(a) * sine;
}

struct Thirds { a: vec4f, b: vec4f, c: vec4f }
struct Fourths { a: vec4f, b: vec4f, c: vec4f, d: vec4f }
struct Fifths { a: vec4f, b: vec4f, c: vec4f, d: vec4f, e: vec4f }

const cos20 = 0.93969262f;  // cosines of degrees
const cos40 = 0.76604444f;
const cos50 = 0.64278761f;
const cos70 = 0.34202014f;
const cos80 = 0.17364818f;
const cos10 = 0.98480775f;
const cos30 = 0.86602540f;
const cos45 = 0.70710678f;
const cos22 = 0.92387953f;  // of a sixteenth of a turn
const cos67 = 0.38268343f;
const cos36 = 0.80901699f;
const cos54 = 0.58778525f;
const cos72 = 0.30901699f;
const cos18 = 0.95105652f;

fn of_three(a: vec4f, b: vec4f, c: vec4f) -> Thirds {
    let sum = b + c;
    let away = turned(b - c) * cos30;
    return Thirds(a + sum, a - 0.5 * sum + away, a - 0.5 * sum - away);
}

fn of_four(a: vec4f, b: vec4f, c: vec4f, d: vec4f) -> Fourths {
    let away = turned(b - d);
    return Fourths(a + c + b + d, a - c + away, a + c - b - d, a - c - away);
}

fn of_five(a: vec4f, b: vec4f, c: vec4f, d: vec4f, e: vec4f) -> Fifths {
    let outer = b + e;
    let inner = c + d;
    let near = a + cos72 * outer - cos36 * inner;
    let far = a - cos36 * outer + cos72 * inner;
    let near_away = turned(cos18 * (b - e) + cos54 * (c - d));
    let far_away = turned(cos54 * (b - e) - cos18 * (c - d));
    return Fifths(a + outer + inner, near + near_away, far + far_away, far - far_away, near - near_away);
}

// The transform of the first numbers of a list.
fn turn_all(values: ptr<function, array<vec4f, 16>>, radix: u32) {
    if (radix == 2u) { turn_two(values); }
    if (radix == 3u) { turn_three(values); }
    if (radix == 4u) { turn_four(values); }
    if (radix == 5u) { turn_five(values); }
    if (radix == 6u) { turn_six(values); }
    if (radix == 8u) { turn_eight(values); }
    if (radix == 9u) { turn_nine(values); }
    if (radix == 10u) { turn_ten(values); }
    if (radix == 12u) { turn_twelve(values); }
    if (radix == 16u) { turn_sixteen(values); }
}

fn turn_two(values: ptr<function, array<vec4f, 16>>) {
    let a = (*values)[0];
    let b = (*values)[1];
    (*values)[0] = a + b;
    (*values)[1] = a - b;
}

fn turn_three(values: ptr<function, array<vec4f, 16>>) {
    let f = of_three((*values)[0], (*values)[1], (*values)[2]);
    (*values)[0] = f.a;
    (*values)[1] = f.b;
    (*values)[2] = f.c;
}

fn turn_four(values: ptr<function, array<vec4f, 16>>) {
    let f = of_four((*values)[0], (*values)[1], (*values)[2], (*values)[3]);
    put_fourths(values, 0u, 1u, f);
}

fn turn_five(values: ptr<function, array<vec4f, 16>>) {
    let f = of_five((*values)[0], (*values)[1], (*values)[2], (*values)[3], (*values)[4]);
    (*values)[0] = f.a;
    (*values)[1] = f.b;
    (*values)[2] = f.c;
    (*values)[3] = f.d;
    (*values)[4] = f.e;
}

fn turn_six(values: ptr<function, array<vec4f, 16>>) {
    let even = of_three((*values)[0], (*values)[2], (*values)[4]);
    let odd = of_three((*values)[1], (*values)[3], (*values)[5]);
    let b = turned_by(odd.b, 0.5, cos30);
    let c = turned_by(odd.c, -0.5, cos30);
    (*values)[0] = even.a + odd.a;
    (*values)[1] = even.b + b;
    (*values)[2] = even.c + c;
    (*values)[3] = even.a - odd.a;
    (*values)[4] = even.b - b;
    (*values)[5] = even.c - c;
}

fn turn_eight(values: ptr<function, array<vec4f, 16>>) {
    let even = of_four((*values)[0], (*values)[2], (*values)[4], (*values)[6]);
    let odd = of_four((*values)[1], (*values)[3], (*values)[5], (*values)[7]);
    let b = turned_by(odd.b, cos45, cos45);
    let c = turned(odd.c);
    let d = turned_by(odd.d, -cos45, cos45);
    put_fourths(values, 0u, 1u, Fourths(even.a + odd.a, even.b + b, even.c + c, even.d + d));
    put_fourths(values, 4u, 1u, Fourths(even.a - odd.a, even.b - b, even.c - c, even.d - d));
}

fn turn_nine(values: ptr<function, array<vec4f, 16>>) {
    let f = of_three((*values)[0], (*values)[3], (*values)[6]);
    let g = of_three((*values)[1], (*values)[4], (*values)[7]);
    let h = of_three((*values)[2], (*values)[5], (*values)[8]);
    let a = of_three(f.a, g.a, h.a);
    let b = of_three(f.b, turned_by(g.b, cos40, cos50), turned_by(h.b, cos80, cos10));
    let c = of_three(f.c, turned_by(g.c, cos80, cos10), turned_by(h.c, -cos20, cos70));
    (*values)[0] = a.a;
    (*values)[1] = b.a;
    (*values)[2] = c.a;
    (*values)[3] = a.b;
    (*values)[4] = b.b;
    (*values)[5] = c.b;
    (*values)[6] = a.c;
    (*values)[7] = b.c;
    (*values)[8] = c.c;
}

fn turn_ten(values: ptr<function, array<vec4f, 16>>) {
    let even = of_five((*values)[0], (*values)[2], (*values)[4], (*values)[6], (*values)[8]);
    let odd = of_five((*values)[1], (*values)[3], (*values)[5], (*values)[7], (*values)[9]);
    let b = turned_by(odd.b, cos36, cos54);
    let c = turned_by(odd.c, cos72, cos18);
    let d = turned_by(odd.d, -cos72, cos18);
    let e = turned_by(odd.e, -cos36, cos54);
    put_fourths(values, 0u, 1u, Fourths(even.a + odd.a, even.b + b, even.c + c, even.d + d));
    (*values)[4] = even.e + e;
    put_fourths(values, 5u, 1u, Fourths(even.a - odd.a, even.b - b, even.c - c, even.d - d));
    (*values)[9] = even.e - e;
}

fn turn_twelve(values: ptr<function, array<vec4f, 16>>) {
    let f = of_four((*values)[0], (*values)[3], (*values)[6], (*values)[9]);
    let g = of_four((*values)[1], (*values)[4], (*values)[7], (*values)[10]);
    let h = of_four((*values)[2], (*values)[5], (*values)[8], (*values)[11]);
    put_thirds(values, 0u, 4u, of_three(f.a, g.a, h.a));
    put_thirds(values, 1u, 4u, of_three(f.b, turned_by(g.b, cos30, 0.5), turned_by(h.b, 0.5, cos30)));
    put_thirds(values, 2u, 4u, of_three(f.c, turned_by(g.c, 0.5, cos30), turned_by(h.c, -0.5, cos30)));
    put_thirds(values, 3u, 4u, of_three(f.d, turned(g.d), -h.d));
}

fn turn_sixteen(values: ptr<function, array<vec4f, 16>>) {
    let f = of_four((*values)[0], (*values)[4], (*values)[8], (*values)[12]);
    let g = of_four((*values)[1], (*values)[5], (*values)[9], (*values)[13]);
    let h = of_four((*values)[2], (*values)[6], (*values)[10], (*values)[14]);
    let i = of_four((*values)[3], (*values)[7], (*values)[11], (*values)[15]);
    put_fourths(values, 0u, 4u, of_four(f.a, g.a, h.a, i.a));
    let b = of_four(f.b, turned_by(g.b, cos22, cos67), turned_by(h.b, cos45, cos45), turned_by(i.b, cos67, cos22));
    put_fourths(values, 1u, 4u, b);
    let c = of_four(f.c, turned_by(g.c, cos45, cos45), turned(h.c), turned_by(i.c, -cos45, cos45));
    put_fourths(values, 2u, 4u, c);
    let d = of_four(f.d, turned_by(g.d, cos67, cos22), turned_by(h.d, -cos45, cos45), turned_by(i.d, -cos22, -cos67));
    put_fourths(values, 3u, 4u, d);
}

fn put_thirds(values: ptr<function, array<vec4f, 16>>, first: u32, step: u32, f: Thirds) {
    (*values)[first] = f.a;
    (*values)[first + step] = f.b;
    (*values)[first + 2u * step] = f.c;
}

fn put_fourths(values: ptr<function, array<vec4f, 16>>, first: u32, step: u32, f: Fourths) {
    (*values)[first] = f.a;
    (*values)[first + step] = f.b;
    (*values)[first + 2u * step] = f.c;
    (*values)[first + 3u * step] = f.d;
}

// ---- tile_rows: indexing, fourier
// Fourier transforms of the rows of all tiles of a photograph without its shading: the low frequencies only. Two rows go
// side by side.

in image: array<f32>;  // (h, w, 3)
in shading: array<f32>;  // (h, w, 3)
in corners: array<i32>;  // (tiles, 2): x and y of a tile's first pixel
out rows: array<vec2f>;  // (tiles, 3, span, kept)

fn detail(row: u32, place: u32) -> f32 {
    let tile = row / (3u * span);
    let x = mirrored(corners[2u * tile] + i32(place), width);
    let y = mirrored(corners[2u * tile + 1u] + i32(row % span), height);
    let at = (y * width + x) * 3u + row / span % 3u;
    return image[at] - shading[at];
}

fn taken(line: u32, x: u32) -> vec4f {
    return vec4f(detail(2u * line, x), 0.0, detail(2u * line + 1u, x), 0.0);
}

fn given(line: u32, x: u32, value: vec4f) {
    if (x < kept) {
        rows[2u * line * kept + x] = value.xy;
        rows[(2u * line + 1u) * kept + x] = value.zw;
    }
}

@workgroup_size(group_size)
fn main(group, groups, local) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}

// ---- tile_columns: indexing, fourier
// The same along the columns: spectra of the tiles as coarser samples have them, one value for one pixel's. Two of all
// columns go side by side.

in rows: array<vec2f>;  // (tiles, 3, span, kept)
out spectra: array<vec2f>;  // (tiles, 3, size, size / 2 + 1)

fn entry(column: u32, y: u32) -> vec2f {
    return rows[(column / kept * span + y) * kept + column % kept];
}

fn taken(line: u32, y: u32) -> vec4f {
    return vec4f(entry(2u * line, y), entry(2u * line + 1u, y));
}

fn given(line: u32, place: u32, value: vec4f) {
    if (place >= kept && place <= span - kept) { return; }
    let y = select(place, place + size - span, place >= kept);
    for (var k = 0u; k < 2u; k++) {
        let column = 2u * line + k;
        spectra[(column / kept * size + y) * (size / 2u + 1u) + column % kept] = select(value.xy, value.zw, k == 1u) * gain;
    }
}

@workgroup_size(group_size)
fn main(group, groups, local) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}

// ---- tile_smoothing: indexing
// Power of the spectra of tiles, averaged over neighbouring frequencies along one axis; spectra repeat beyond the ends.
// An invocation has four neighbours along the axis, whose frequencies overlap.

in before: array<f32>;  // (tiles, 3, size, size / 2 + 1), complex, or powers later
in taps: array<f32>;  // (2 reach + 4,): three zeros at the end
out power: array<f32>;

const columns = size / 2u + 1u;
const fours = (select(size, columns, along_x) + 3u) / 4u;

fn power_at(at: u32) -> f32 {
    if (!is_spectrum) { return before[at]; }
    let value = vec2f(before[2u * at], before[2u * at + 1u]);
    return dot(value, value);
}

fn main(i) {
    if (i >= pictures * select(columns, size, along_x) * fours) { return; }
    let first = 4u * select(i / columns % fours, i % fours, along_x);
    let line = select(i % columns, i / fours % size, along_x);
    let picture = i / (fours * select(columns, size, along_x)) * size * columns;
    let mirrored_line = select(size - line, 0u, line == 0u);
    var sum = vec4f();
    var weights = vec4f();  // of the four frequencies, for what is read
    var place = (first + size - reach) % size;
    for (var k = 0u; k < 2u * reach + 4u; k++) {
        weights = vec4f(taps[k], weights.xyz);
        var at = picture + place * columns + line;
        if (along_x) {  // the other half of a real picture's spectrum is the first one, mirrored
            at = picture + select(line * columns + place, mirrored_line * columns + size - place, place >= columns);
        }
        sum += weights * power_at(at);
        place = select(place + 1u, 0u, place + 1u == size);
    }
    for (var n = 0u; n < min(4u, select(size, columns, along_x) - first); n++) {
        power[picture + select((first + n) * columns + line, line * columns + first + n, along_x)] = sum[n];
    }
}

// ---- tile_signal: indexing
// The fraction of the tiles' power that is no noise, at every frequency; see `readable/tiles.py`.

in power: array<f32>;  // (tiles, 3, size, size / 2 + 1)
in noise: array<f32>;  // (tiles, 3): power of the noise at any frequency
out signal_share: array<f32>;

fn main(i) {
    if (i >= pictures * frequencies) { return; }
    let least = noise[i / frequencies];
    signal_share[i] = clamp(1.0 - least / max(power[i], least + 1.0e-30), 0.0, 1.0);  // 1e-30: no division by 0
}

// ---- cross_columns: indexing, fourier
// Two channels of a tile filtered with each other's blur, P and Q, transformed back along the columns; see
// `blur.py`. Frequencies of half a cycle a sample are left out.

in pair_spectra: array<vec4f>;  // (tiles, all pairs, span, kept)
in transfers: array<vec2f>;  // (layers of a round, tiles, channels, span, kept)
// (layers of a round, tiles, pairs, middle, kept): P and Q of the middle rows
out columns: array<vec4f>;

const kept = span / 2u;

fn taken(line: u32, y: u32) -> vec4f {
    let pair = line / kept % pair_count;
    let picture = line / (kept * pair_count);
    let place = y * kept + line % kept;
    let packed = pairs >> (4u * pair);  // where both channels are among those of the transfer functions
    let both = pair_spectra[((picture % tiles * all_pairs + pair) * span + y) * kept + line % kept];
    let blur_a = transfers[(picture * channels + (packed & 3u)) * span * kept + place];
    let blur_b = transfers[(picture * channels + ((packed >> 2u) & 3u)) * span * kept + place];
    let gain = inverseSqrt((dot(blur_a, blur_a) + dot(blur_b, blur_b)) * 0.5 + damping);
    return vec4f(times(both.xy, blur_b), times(both.zw, blur_a)) * gain;
}

fn given(line: u32, y: u32, value: vec4f) {
    let row = y - (span - middle) / 2u;
    if (row < middle) { columns[(line / kept * middle + row) * kept + line % kept] = value; }
}

@workgroup_size(group_size)
fn main(group, groups, local) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}

// ---- cross_rows: indexing, fourier
// The transform of `cross_columns` along the rows: P and Q of the middle of every tile as the real and the imaginary
// part of one picture. Two rows go side by side.

in columns: array<vec4f>;  // (pictures, middle, kept)
out views: array<vec2f>;  // (pictures, middle, middle)

const kept = span / 2u;

// P + i Q at a frequency, or at the negative of this one.
fn joined(both: vec4f, negative: bool) -> vec2f {
    return select(vec2f(both.x - both.w, both.y + both.z), vec2f(both.x + both.w, both.z - both.y), negative);
}

fn taken(line: u32, x: u32) -> vec4f {
    if (x == kept) { return vec4f(); }
    let at = 2u * line * kept + select(x, span - x, x > kept);
    return vec4f(joined(columns[at], x > kept), joined(columns[at + kept], x > kept));
}

fn given(line: u32, x: u32, value: vec4f) {
    let column = x - (span - middle) / 2u;
    if (column < middle) {
        views[2u * line * middle + column] = value.xy;
        views[(2u * line + 1u) * middle + column] = value.zw;
    }
}

@workgroup_size(group_size)
fn main(group, groups, local) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}
