// The language of expressions as xitl_cli/logs/expressions reads it, over the signals that the page holds. Nothing is run.

const expressions = (() => {
"use strict";
const LONGEST = 1000, DEEPEST = 50, SHORT_WAY = "gives the shorter angle";
const fail = (sentence) => { throw new Error(sentence); };

// Syntax

const FIELDS = "(?:\\[\\d+\\]|\\s*\\.\\s*[\\p{L}\\p{N}_]+)*";
const PATTERNS = {
  number: /(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\p{L}\p{N}_])/uy,
  text: /'[^']*'|"[^"]*"/uy,
  topic: new RegExp(`(?:/[\\p{L}_][\\p{L}\\p{N}_]*)+(?::[\\p{L}_][\\p{L}\\p{N}_]*)?${FIELDS}`, "uy"),
  name: new RegExp(`[\\p{L}_][\\p{L}\\p{N}_]*${FIELDS}`, "uy"),
  sign: /\*\*|==|!=|<=|>=|[-+*/%<>(),]/uy,
};
const RESERVED = new Set(["and", "or", "not", "in", "is", "if", "else", "for", "lambda", "await", "yield"]);
const matched = (pattern, text, at) => { pattern.lastIndex = at; return pattern.exec(text)?.[0]; };

/** The tree of a text; known: names of tables that hold more than words. */
const parseExpression = (text, known = []) => {
  if (text.length > LONGEST) fail(`is longer than ${LONGEST} characters`);
  const odd = known.filter((name) => [PATTERNS.topic, PATTERNS.name].every((pattern) => matched(pattern, name, 0) !== name)).sort((a, b) => b.length - a.length);
  let at = 0, depth = 0, ended = 0, token;
  const broken = (why) => fail(`is not a valid expression (${why})`);
  const next = (operand) => {
    ended = at;
    while (/\s/.test(text[at] ?? "")) at += 1;
    const put = (kind, raw) => { token = { kind, text: kind === "name" ? raw.replace(/\s/g, "") : raw, begin: at }; at += raw.length; };
    if (at >= text.length) { token = { kind: "end", text: "", begin: at }; return; }
    for (const name of odd) if (text.startsWith(name, at) && (operand || !name.startsWith("/"))) {
      put("name", name + (matched(new RegExp(FIELDS, "uy"), text, at + name.length) ?? ""));
      return;
    }
    for (const kind of ["number", "text", ...(operand ? ["topic"] : []), "name", "sign"]) {
      const raw = matched(PATTERNS[kind], text, at);
      if (raw) { put(RESERVED.has(raw) ? "word" : kind === "topic" ? "name" : kind, raw); return; }
    }
    broken(text[at] === "=" ? "= does not compare; write ==" : `'${text[at]}' at its character ${at + 1}`);
  };
  const is = (sign) => (token.kind === "sign" || token.kind === "word") && token.text === sign;
  const unexpected = () => broken(token.kind === "end" ? "it is incomplete" : `'${token.text}' is not allowed at its character ${token.begin + 1}`);
  const node = (type, begin, parts) => ({ type, text: text.slice(begin, ended), begin, ...parts });
  const deeper = (read) => {
    depth += 1;
    if (depth > DEEPEST) fail(`is nested more than ${DEEPEST} levels deep`);
    const found = read();
    depth -= 1;
    return found;
  };
  const joined = (sign, part) => {
    const parts = [part()];
    while (is(sign)) { next(true); parts.push(part()); }
    return parts.length === 1 ? parts[0] : node("junction", parts[0].begin, { sign, parts });
  };
  const prefixed = (signs, again, below) => {
    if (!signs.some(is)) return below();
    const { begin, text: sign } = token;
    next(true);
    const operand = deeper(again);
    return node("prefix", begin, { sign, operand });
  };
  const chain = (signs, part) => {
    let left = part();
    for (let many = 0; signs.some(is); many += 1) {
      if (many >= DEEPEST) fail(`is nested more than ${DEEPEST} levels deep`);
      const sign = token.text;
      next(true);
      const right = part();
      left = node("arithmetic", left.begin, { sign, left, right });
    }
    return left;
  };
  const disjunction = () => joined("or", () => joined("and", negation));
  const negation = () => prefixed(["not"], negation, comparison);
  const comparison = () => {
    const sides = [sum()], signs = [];
    while (token.kind === "sign" && ["==", "!=", "<", "<=", ">", ">="].includes(token.text)) { signs.push(token.text); next(true); sides.push(sum()); }
    return signs.length ? node("comparison", sides[0].begin, { signs, sides }) : sides[0];
  };
  const sum = () => chain(["+", "-"], () => chain(["*", "/", "%"], signed));
  const signed = () => prefixed(["-", "+"], signed, power);
  const power = () => {
    const left = operand();
    if (!is("**")) return left;
    next(true);
    const right = deeper(signed);
    return node("arithmetic", left.begin, { sign: "**", left, right });
  };
  const operand = () => {
    const { kind, text: raw, begin } = token;
    if (kind === "number") { next(false); return node("number", begin, { value: Number(raw) }); }
    if (kind === "text") { next(false); return node("text", begin, { value: raw.slice(1, -1) }); }
    if (kind === "name") return named(raw, begin);
    if (!is("(")) return unexpected();
    next(true);
    const inner = deeper(disjunction);
    close();
    return { ...inner, begin };
  };
  const named = (path, begin) => {
    next(false);
    if (["true", "True", "false", "False"].includes(path)) return node("truth", begin, { value: path.toLowerCase() === "true" });
    if (!is("(")) return node("name", begin, { path });
    const known = FUNCTIONS[path] ?? fail(`calls ${path}, which is not known; there are ${Object.keys(FUNCTIONS).join(", ")}`);
    next(true);
    const parts = deeper(() => {
      const read = [];
      while (!is(")")) { read.push(disjunction()); if (!is(",")) break; next(true); }
      return read;
    });
    close();
    const [least, most] = known.takes;
    if (parts.length < least || parts.length > most) fail(`gives ${path} ${parts.length} values, and it takes ${least === most ? least : `${least} to ${most}`}`);
    return node("call", begin, { name: path, parts });
  };
  const close = () => { if (!is(")")) unexpected(); next(false); };
  next(true);
  const tree = disjunction();
  if (token.kind !== "end") unexpected();
  return tree;
};
const namesIn = (tree) => tree.type === "name" ? [tree.path]
  : [tree.operand, tree.left, tree.right, ...(tree.parts ?? []), ...(tree.sides ?? [])].filter(Boolean).flatMap(namesIn);

// Units: null of a plain number, "" where it cannot be told

const RAISED = { 1: "", 2: "²", 3: "³" };
const sameUnit = (units) => {
  const known = units.filter((unit) => unit !== null);
  return known.length ? (known.every((unit) => unit === known[0]) ? known[0] : "") : null;
};
const powersOf = (unit) => {
  if (!unit) return null;
  const powers = {};
  for (const [number, part] of unit.split("/").entries()) for (const factor of part.split(/[.·*]/)) {
    if (number === 0 && factor === "1") continue;
    const found = /^([A-Za-zµ°%]+)\^?([²³]|\d)?$/.exec(factor);
    if (!found) return null;
    const power = { "²": 2, "³": 3 }[found[2]] ?? Number(found[2] ?? 1);
    powers[found[1]] = (powers[found[1]] ?? 0) + (number === 0 ? power : -power);
  }
  return powers;
};
const unitOf = (powers) => {
  const above = Object.entries(powers).filter(([, power]) => power > 0).map(([name, power]) => name + (RAISED[power] ?? `^${power}`));
  const below = Object.entries(powers).filter(([, power]) => power < 0).map(([name, power]) => `/${name}`.repeat(-power)).join("");
  return above.length ? above.join(".") + below : below ? `1${below}` : "";
};
const productUnit = (left, right, power = 1) => {
  if (right === null) return left;
  const factors = left === null ? {} : powersOf(left), others = powersOf(right);
  if (!factors || !others) return "";
  const powers = { ...factors };
  for (const [name, each] of Object.entries(others)) powers[name] = (powers[name] ?? 0) + power * each;
  return unitOf(powers);
};
const powerUnit = (unit, exponent) => {
  if (unit === null) return null;
  const powers = Object.entries(powersOf(unit) ?? { x: 0.5 }).map(([name, power]) => [name, power * exponent]);
  return powersOf(unit) && powers.every(([, power]) => Number.isInteger(power)) ? unitOf(Object.fromEntries(powers)) : "";
};
const converted = (unit, from, to) => unit ? productUnit(unit, productUnit(to, from, -1)) : to;

// Functions

const modulo = (x, y) => { const rest = x % y; return rest !== 0 && (rest < 0) !== (y < 0) ? rest + y : rest; };
const wrapped = (turn, low) => (x) => modulo(x - low, turn) + low;
const smaller = (a, b) => (Number.isNaN(a) || Number.isNaN(b) ? NaN : Math.min(a, b));
const larger = (a, b) => (Number.isNaN(a) || Number.isNaN(b) ? NaN : Math.max(a, b));
const each = (apply, unit = sameUnit, takes = [1, 1], angles = "") => ({ apply, unit, takes, angles });
const overTime = (along, unit, takes = [1, 1]) => ({ along, unit, takes });
const degree = Math.PI / 180, none = () => null, radian = () => "rad";
const unwrapped = (values, turn) => {
  const found = Float64Array.from(values);
  let shift = 0, last = NaN;
  values.forEach((value, row) => {
    if (!Number.isFinite(value)) return;
    const step = value - last, half = turn / 2, rest = modulo(step + half, turn) - half;
    if (Math.abs(step) >= half) shift += (rest === -half && step > 0 ? half : rest) - step;
    last = value;
    found[row] = value + shift;
  });
  return found;
};
const derivative = (t, x) => {
  const last = x.length - 1;
  if (last < 1) return x.map(() => NaN);
  return x.map((value, row) => {
    if (row === 0) return (x[1] - x[0]) / (t[1] - t[0]);
    if (row === last) return (x[last] - x[last - 1]) / (t[last] - t[last - 1]);
    const h = t[row] - t[row - 1], k = t[row + 1] - t[row];
    return (h * h * x[row + 1] + (k * k - h * h) * value - k * k * x[row - 1]) / (h * k * (h + k));
  });
};
const integral = (t, x) => {
  let sum = 0;
  return x.map((value, row) => {
    const strip = row ? 0.5 * (value + x[row - 1]) * (t[row] - t[row - 1]) : 0;
    return (sum += Number.isNaN(strip) ? 0 : strip);
  });
};
const smooth = (t, x, window) => {
  const half = 0.5 * window + 1e-9, sums = [0], counts = [0];
  x.forEach((value, row) => { const known = Number.isFinite(value); sums.push(sums[row] + (known ? value : 0)); counts.push(counts[row] + (known ? 1 : 0)); });
  let first = 0, after = 0;
  return x.map((_, row) => {
    while (t[first] < t[row] - half) first += 1;
    while (after < t.length && t[after] <= t[row] + half) after += 1;
    return (sums[after] - sums[first]) / (counts[after] - counts[first]);
  });
};
const FUNCTIONS = {
  abs: each(Math.abs), sign: each(Math.sign, none), floor: each(Math.floor), ceil: each(Math.ceil),
  sqrt: each(Math.sqrt, ([unit]) => powerUnit(unit, 0.5)), exp: each(Math.exp, none), log: each(Math.log, none), log10: each(Math.log10, none),
  hypot: each((...sides) => Math.sqrt(sides.reduce((sum, side) => sum + side * side, 0)), sameUnit, [2, 3]),
  sin: each(Math.sin, none, [1, 1], "rad"), cos: each(Math.cos, none, [1, 1], "rad"), tan: each(Math.tan, none, [1, 1], "rad"),
  asin: each(Math.asin, radian), acos: each(Math.acos, radian), atan: each(Math.atan, radian), atan2: each(Math.atan2, radian, [2, 2]),
  radians: each((x) => x * degree, ([unit]) => converted(unit, "deg", "rad"), [1, 1], "deg"),
  degrees: each((x) => x / degree, ([unit]) => converted(unit, "rad", "deg"), [1, 1], "rad"),
  wrap180: each(wrapped(360, -180), sameUnit, [1, 1], "deg"), wrap360: each(wrapped(360, 0), sameUnit, [1, 1], "deg"),
  wrap_pi: each(wrapped(2 * Math.PI, -Math.PI), sameUnit, [1, 1], "rad"),
  min: each((...values) => values.reduce(smaller), sameUnit, [2, Infinity]), max: each((...values) => values.reduce(larger), sameUnit, [2, Infinity]),
  clip: each((x, low, high) => smaller(larger(x, low), high), sameUnit, [3, 3]),
  unwrap: overTime((t, x, _, unit) => unwrapped(x, unit === "rad" ? 2 * Math.PI : 360), ([unit]) => unit),
  diff: overTime((t, x) => x.map((value, row) => (row ? value - x[row - 1] : NaN)), ([unit]) => unit),
  derivative: overTime(derivative, ([unit]) => productUnit(unit, "s", -1)),
  integral: overTime(integral, ([unit]) => productUnit(unit, "s")),
  smooth: overTime(smooth, ([unit]) => unit, [2, 2]),
  where: { takes: [3, 3] },
};
const ROUND = new Set(["sin", "cos", "tan", "wrap180", "wrap360", "wrap_pi", "unwrap", "radians", "degrees"]);

// Evaluation: a quantity is { kind: "number" | "truth" | "text", at: (row) => value, constant, unit }

const COMPARE = { "==": (a, b) => a === b, "!=": (a, b) => a !== b, "<": (a, b) => a < b, "<=": (a, b) => a <= b, ">": (a, b) => a > b, ">=": (a, b) => a >= b };
const COMPUTE = { "+": (a, b) => a + b, "-": (a, b) => a - b, "*": (a, b) => a * b, "/": (a, b) => a / b, "%": modulo, "**": (a, b) => a ** b };
const worksOut = (tree, resolve, t, notes) => {
  const quantity = (kind, at, unit = null, constant = false) => ({ kind, at, unit, constant });
  const all = (apply) => Float64Array.from(t, (_, row) => apply(row));
  const of = (node) => {
    if (node.type === "number") return quantity("number", () => node.value, null, true);
    if (node.type === "text") return quantity("text", () => node.value);
    if (node.type === "truth") return quantity("truth", () => node.value);
    if (node.type === "name") { const { values, unit } = resolve(node.path); return quantity("number", (row) => values[row], unit); }
    if (node.type === "prefix" && node.sign === "not") { const one = truth(node.operand); return quantity("truth", (row) => !one.at(row)); }
    if (node.type === "prefix") { const one = number(node.operand); return node.sign === "+" ? one : quantity("number", (row) => -one.at(row), one.unit, one.constant); }
    if (node.type === "junction") {
      const parts = node.parts.map(truth);
      return quantity("truth", node.sign === "and" ? (row) => parts.every((part) => part.at(row)) : (row) => parts.some((part) => part.at(row)));
    }
    if (node.type === "comparison") return compared(node);
    return node.type === "arithmetic" ? computed(node) : called(node);
  };
  const number = (node) => { const one = of(node); return one.kind === "number" ? one : fail(`cannot be evaluated: '${node.text}' is not a number`); };
  const truth = (node) => { const one = of(node); return one.kind === "truth" ? one : fail(`cannot be evaluated: '${node.text}' is not a condition; compare it, such as '… > 0'`); };
  const compared = (node) => {
    const sides = node.sides.map(of);
    if (new Set(sides.map((side) => side.kind === "text")).size > 1) fail("compares a text with a number; put quotes around texts only");
    return quantity("truth", (row) => node.signs.every((sign, index) => COMPARE[sign](sides[index].at(row), sides[index + 1].at(row))));
  };
  const computed = (node) => {
    const left = number(node.left), right = number(node.right), compute = COMPUTE[node.sign];
    let unit = sameUnit([left.unit, right.unit]);
    if (node.sign === "*" || node.sign === "/") unit = productUnit(left.unit, right.unit, node.sign === "*" ? 1 : -1);
    if (node.sign === "**") unit = right.constant ? powerUnit(left.unit, right.at(0)) : left.unit === null ? null : "";
    const at = (row) => compute(left.at(row), right.at(row));
    if ((node.sign === "+" || node.sign === "-") && left.unit && right.unit) {
      if (!unit) notes.push(`${node.text} mixes ${left.unit} and ${right.unit}`);
      const half = { deg: 180, rad: Math.PI }[unit];
      if (half && node.sign === "-" && t.some((_, row) => Math.abs(at(row)) > half))
        notes.push(`${node.text} exceeds half a turn; ${unit === "deg" ? "wrap180" : "wrap_pi"}(${node.text}) ${SHORT_WAY}`);
    }
    return quantity("number", at, unit, left.constant && right.constant);
  };
  const called = (node) => {
    if (node.name === "where") {
      const which = truth(node.parts[0]), one = number(node.parts[1]), other = number(node.parts[2]);
      return quantity("number", (row) => (which.at(row) ? one.at(row) : other.at(row)), sameUnit([one.unit, other.unit]));
    }
    const { apply, along, unit, angles } = FUNCTIONS[node.name], told = notes.length;
    const values = node.parts.map(number), units = values.map((value) => value.unit);
    if (ROUND.has(node.name)) notes.push(...notes.splice(told).filter((note) => !note.endsWith(SHORT_WAY)));
    if (along) {
      if (values[1] && !(values[1].constant && values[1].at(0) > 0)) fail(`contains ${node.text}: the time must be a number of seconds above 0`);
      const found = along(t, all(values[0].at), values[1]?.at(0), units[0]);
      return quantity("number", (row) => found[row], unit(units));
    }
    const given = { deg: "rad", rad: "deg" }[angles], argument = node.parts[0].text, turned = angles === "rad" ? "radians" : "degrees";
    if (given && units[0] === given)
      notes.push(`${node.text} takes ${angles} and gets ${given}; write ${["radians", "degrees"].includes(node.name) ? argument : `${node.name}(${turned}(${argument}))`}`);
    return quantity("number", (row) => apply(...values.map((value) => value.at(row))), unit(units), values.every((value) => value.constant));
  };
  const result = of(tree);
  if (result.kind === "text") fail("is a text, not a signal; compare it with another text");
  return { values: all((row) => Number(result.at(row))), unit: result.unit ?? "", held: result.kind === "truth" };
};

// Signals: a source is { label, tables: [{ name, instance, t, columns: { Roll: { values, unit, held } } }] }

const TURN = { deg: 360, rad: 2 * Math.PI };
const tableLabel = (table, source) => table.instance === null ? table.name
  : source.tables.filter(({ name }) => name === table.name).length > 1 ? `${table.name}[${table.instance}]` : table.name;
const near = (wanted, names) => {
  const pairs = (text) => new Set([...text.toLowerCase()].map((letter, index, letters) => letter + (letters[index + 1] ?? "")));
  const mine = pairs(wanted), likeness = (name) => { const others = pairs(name); return [...mine].filter((pair) => others.has(pair)).length / Math.max(mine.size, others.size, 1); };
  const best = [...names].sort((a, b) => likeness(b) - likeness(a))[0];
  return best !== undefined && likeness(best) > 0.3 ? `did you mean ${best}? ` : "";
};
/** { table, field } of a path; of a message with instances the lowest where none is written. */
const columnOf = (source, path) => {
  const wanted = path.toLowerCase(), names = [...new Set(source.tables.map((table) => table.name))];
  const name = names.filter((each) => wanted === each.toLowerCase() || ["." , "["].some((end) => wanted.startsWith(each.toLowerCase() + end))).sort((a, b) => b.length - a.length)[0];
  const typed = path.split(/[.[]/)[0];
  if (name === undefined) fail(`names ${typed}, and there is no such message on this page; ${near(typed, names)}the list has them all`);
  const [, instance, field] = /^(?:\[(\d+)\])?(?:\.(.+))?$/u.exec(path.slice(name.length)) ?? fail(`names ${path}; write ${name}.FIELD`);
  const tables = source.tables.filter((table) => table.name === name);
  const table = instance === undefined || tables[0].instance === null ? tables[0] : tables.find((each) => each.instance === Number(instance));
  if (!table || (tables[0].instance === null && Number(instance ?? 0))) fail(`names ${name}[${instance}], and there is ${tables.map((each) => tableLabel(each, source)).join(", ")}`);
  const fields = Object.keys(table.columns), found = fields.find((each) => each === field) ?? fields.find((each) => each.toLowerCase() === field?.toLowerCase());
  if (found === undefined) fail(`names ${path}: ${field === undefined ? "a field is missing" : `${name} has no field ${field}`}; ${near(field ?? "", fields)}it has ${fields.slice(0, 12).join(", ")}`);
  return { table, field: found, column: table.columns[found] };
};
const rowsRising = (t) => { const rows = []; let newest = -Infinity; t.forEach((at, row) => { if (at > newest) { rows.push(row); newest = at; } }); return rows; };
const firstNotBelow = (sorted, at) => { let low = 0, high = sorted.length; while (low < high) { const middle = (low + high) >> 1; if (sorted[middle] < at) low = middle + 1; else high = middle; } return low; };
/** Between the rows on a straight line, an angle the short way round, a state as it was last; NaN elsewhere and in pauses. */
const interpolated = (table, column, at) => {
  const rows = rowsRising(table.t).filter((row) => column.held || Number.isFinite(column.values[row]));
  const t = rows.map((row) => table.t[row]), values = Float64Array.from(rows, (row) => column.values[row]);
  if (!rows.length) return at.map(() => NaN);
  if (column.held) return at.map((when) => { const after = firstNotBelow(t, when), row = t[after] === when ? after : after - 1; return row < 0 ? NaN : values[row]; });
  const turn = TURN[column.unit], line = turn ? unwrapped(values, turn) : values;
  const turns = turn && line.some((value, row) => value !== values[row]), low = turns && (values.some((value) => value < 0) ? -turn / 2 : 0);
  const steps = t.slice(1).map((when, row) => when - t[row]).sort((a, b) => a - b), middle = steps.length >> 1;
  const median = steps.length % 2 ? steps[middle] : (steps[middle - 1] + steps[middle]) / 2, pause = Math.max(1, 10 * median);
  return at.map((when) => {
    const after = firstNotBelow(t, when);
    if (t[after] === when) return turns ? modulo(line[after] - low, turn) + low : line[after];
    if (after === 0 || after === t.length || t[after] - t[after - 1] > pause) return NaN;
    const found = line[after - 1] + ((line[after] - line[after - 1]) / (t[after] - t[after - 1])) * (when - t[after - 1]);
    return turns ? modulo(found - low, turn) + low : found;
  });
};
/** What a name or an expression is: { t, values, unit, held, base, others, notes }. Throws what is wrong with it. */
const signalOf = (source, text) => {
  const tree = parseExpression(text, source.tables.map((table) => table.name));
  if (tree.type === "name" && tree.path.toLowerCase() !== "time_s") {
    const { table, column } = columnOf(source, tree.path);
    return { t: table.t, values: column.values, unit: column.unit, held: column.held, base: tableLabel(table, source), others: [], notes: [] };
  }
  const paths = [...new Set(namesIn(tree))].filter((path) => path.toLowerCase() !== "time_s");
  const columns = new Map(paths.map((path) => [path, columnOf(source, path)]));
  if (!columns.size) fail("contains no signal; add one, such as ATT.Roll");
  const tables = new Map([...columns.values()].map(({ table }) => [table, rowsRising(table.t)]));
  const first = ([table, rows]) => table.t[rows[0]], last = ([table, rows]) => table.t[rows[rows.length - 1]];
  const moving = [...tables].filter(([table]) => [...columns.values()].some((each) => each.table === table && !each.column.held));
  const begin = Math.max(...[...tables].map(first)), end = Math.min(...(moving.length ? moving : [...tables]).map(last));
  const inside = [...tables].map(([table, rows]) => [table, rows.filter((row) => table.t[row] >= begin && table.t[row] <= end)]);
  const [base, rows] = inside.reduce((best, each) => (each[1].length > best[1].length ? each : best));
  if (!rows.length) fail(`is of ${[...tables.keys()].map((table) => tableLabel(table, source)).join(" and ")}, which do not overlap in time`);
  const t = Float64Array.from(rows, (row) => base.t[row]), notes = [];
  const known = new Map([...columns].map(([path, { table, column }]) =>
    [path, { unit: column.unit, values: table === base ? rows.map((row) => column.values[row]) : interpolated(table, column, t) }]));
  const found = worksOut(tree, (path) => known.get(path) ?? { unit: "s", values: t }, t, notes);
  const others = [...tables.keys()].filter((table) => table !== base).map((table) => tableLabel(table, source));
  return { t, ...found, base: tableLabel(base, source), others, notes: [...new Set(notes)] };
};
return { signalOf, tableLabel };
})();
