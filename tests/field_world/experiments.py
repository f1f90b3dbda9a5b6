"""The experiments: each function returns the world of one log."""

from __future__ import annotations

import numpy as np

from tests.field_world.chips import G0
from tests.field_world.rotation import about, of_vectors, product
from tests.field_world.signals import lag, smooth_step
from tests.field_world.streams import stream
from tests.field_world.surroundings import FACE, PAD, UP, World


def keyframes(w, keys, ts):
    """Turn the box through the attitudes `keys` in the times `ts`; return where (0 to 1) a hand holds it."""
    q = np.tile(keys[0], (w.n, 1)).astype(float)
    hold = np.zeros(w.n)
    for i, (a, b) in enumerate(ts):
        d = product(keys[i] * np.array([1, -1, -1, -1]), keys[i + 1])
        if d[0] < 0:
            d = -d
        ang = 2 * np.arctan2(np.linalg.norm(d[1:]), d[0])
        ax = d[1:] / max(np.linalg.norm(d[1:]), 1e-12)
        u = smooth_step((w.t - a) / (b - a))
        k = w.t >= a
        q[k] = product(keys[i], about(ax, ang * u[k]))
        hold = np.maximum(hold, smooth_step((w.t - a + 0.7) / 0.6) * smooth_step((b + 0.6 - w.t) / 0.6))
    w.q = q
    return hold


def static(
    key,
    dur,
    fs=400,
    start_c=23.0,
    face="z_up",
    level=1.0,
    walkers=0,
    hum=0.0,
    tilt=0.0,
    wind=0.0,
    temp=("room", {}),
    labels=True,
    finish=True,
    mag_hum=0.0,
):
    """The box lies still on a table."""
    w = World(key, dur, fs, start_c)
    w.q = product(about([0, 0, 1], w.r("yaw").uniform(0, 6.28)), np.tile(FACE[face], (w.n, 1)))
    w.level()
    if tilt:
        w.tilt_slowly(tilt)
    w.building(level, walkers, hum, mag_hum=mag_hum)
    if wind:
        w.wind(wind)
    w.temperature(temp[0], **temp[1])
    if labels:
        w.phases = [(0.0, dur, "static", UP[face])]
    return w.finish() if finish else w


def faces(
    key,
    order,
    dwell=20.0,
    move=(2.5, 4.5),
    fs=500,
    start_c=23.0,
    first=3.0,
    temp=("room", {}),
    check=True,
    hard=0.25,
    settle=1.5,
    level=1.0,
    walkers=0,
    finish=True,
):
    """The box is put on its faces by hand, in this order."""
    g = stream(*key, "world", "faces")
    t, ts, keys, ph = first, [], [], []
    seen = {}
    for i, f in enumerate(order):
        keys.append(
            product(
                about([g.normal(), g.normal(), 1e-9], np.deg2rad(0.25) * abs(g.normal())),
                product(about([0, 0, 1], g.uniform(-0.5, 0.5)), FACE[f]),
            )
        )
        d = dwell * g.uniform(0.85, 1.25)
        a = t + (settle if i else 0.0) - (first if not i else 0)
        t += d
        name = f if f not in seen else f + "_check"
        seen[f] = 1
        ph.append((a, t - 0.9, name, UP[f]))
        if i < len(order) - 1:
            m = g.uniform(*move)
            ts.append((t, t + m))
            t += m
    w = World(key, t + 0.5, fs, start_c)
    hold = keyframes(w, keys, ts)
    for a, b in ts:  # lift, carry, put down, fingers leave
        u = (w.t - a) / (b - a)
        p = np.where((u > 0) & (u < 1), np.sin(np.pi * np.clip(u, 0, 1)) ** 4, 0) * g.uniform(0.08, 0.2)
        w.a[:, 2] += np.gradient(np.gradient(p, 1 / fs), 1 / fs)
        h = np.where((u > 0) & (u < 1), np.sin(np.pi * np.clip(u, 0, 1)) ** 4, 0) * g.uniform(-0.15, 0.15, (2, 1))
        w.a[:, :2] += np.gradient(np.gradient(h, 1 / fs, axis=1), 1 / fs, axis=1).T
        w.shock(b - 0.02, hard * g.uniform(0.4, 1.6), g)
        w.shock(b + g.uniform(0.08, 0.25), 0.3 * hard * g.uniform(0.2, 1.0), g)
        rel = b + g.uniform(0.4, 0.9)  # the last finger goes: a small relief
        w.turn([g.normal(), g.normal(), 0], np.deg2rad(0.03) * g.normal() * smooth_step((rel - w.t) / 0.15) * (w.t > b))
    w.tremor(hold * 1.0)
    w.building(level, walkers)
    w.temperature(temp[0], **temp[1])
    w.phases = ph
    return w.finish() if finish else w


def tumble(key, dur, fs=500, start_c=23.0, brisk=1.0, temp=("warmup", {"dT": 1.5}), rest=6.0, npause=0, finish=True):
    """Tumbled in the hands: some 1.5 s from attitude to attitude, short halts, at rest at both ends."""
    w = World(key, dur, fs, start_c)
    g = w.r("tumble")
    keys, ts, t = [FACE["z_up"]], [], rest
    while t < dur - rest - 3:
        v = g.normal(size=4)
        keys.append(v / np.linalg.norm(v))
        m = g.uniform(1.0, 2.6) / brisk
        ts.append((t, t + m))
        t += m + g.choice([0.1, 0.3, 1.2], p=[0.45, 0.35, 0.2])
    keys.append(FACE["z_up"])
    ts.append((t, t + 2.0))
    hold = keyframes(w, keys, ts)
    sm = smooth_step((w.t - rest + 1) / 1.0) * smooth_step((t + 2.6 - w.t) / 0.6)
    w.tremor(np.maximum(hold * 0, sm), 0.5, 0.3)
    w.a += sm[:, None] * w.noise("arms", 0.3, 1.8, 0.9, 3) * brisk
    w.shock(t + 1.98, 0.25, g)
    w.building()
    w.temperature(temp[0], **temp[1])
    w.phases = [(0.0, rest - 1.0, "static", "+Z"), (rest, t + 2.0, "motion", "")]
    w.marks["moving"] = (rest, t)
    return w.finish() if finish else w


def rover(
    key,
    dur,
    fs=2000,
    start_c=21.0,
    vib=1.0,
    temp=("warmup", {"dT": 3.0, "tau": 200}),
    rest=8.0,
    labels=True,
    finish=True,
):
    """A rover drives, its motor vibrates with the speed."""
    w = World(key, dur, fs, start_c)
    g = w.r("rover")
    speed = np.zeros(w.n)
    t = rest
    tp, sp = [-PAD, t], [0, 0]
    while t < dur - rest - 6:
        v = g.choice([0, 0.25, 0.5, 0.8, 1.0], p=[0.1, 0.2, 0.3, 0.25, 0.15])
        t += g.uniform(0.8, 1.6)
        tp.append(t)
        sp.append(v)
        t += g.uniform(2, 8)
        tp.append(t)
        sp.append(v)
    t += 1.2
    tp.append(t)
    sp.append(0)
    tp.append(dur + PAD)
    sp.append(0)
    speed = lag(np.interp(w.t, tp, sp), fs, 0.15)
    on = np.clip(speed / 0.08, 0, 1)
    w.a[:, 0] += np.gradient(speed, 1 / fs)
    yaw = w.slow("steer", 4.0, 0.35) * speed
    psi = np.cumsum(yaw) / fs
    w.turn([0, 0, 1], psi)
    w.a[:, :2] += (speed * yaw)[:, None] * np.stack([-np.sin(psi) * 0, np.cos(psi) * 0 + 1], 1)
    f0 = 14 + 92 * speed + 1.5 * w.slow("load", 3.0, 1.0)  # motor and gear: the line follows the speed
    ph = 2 * np.pi * np.cumsum(f0) / fs
    for k, amp in ((1, 0.7), (2, 1.0), (3, 0.35), (5, 0.2)):
        u = g.normal(size=3) * [0.6, 0.7, 1.0]
        w.fv += (
            ((0.25 + speed) * on * amp * vib * 0.45 * np.sin(k * ph + g.uniform(0, 6)))[:, None] * u / np.linalg.norm(u)
        )
        w.wv += ((0.25 + speed) * on * amp * vib * 0.012 * np.sin(k * ph + g.uniform(0, 6)))[:, None] * g.normal(size=3)
    w.fv += (speed * vib)[:, None] * w.noise("ground", 3, 60, 0.8, 3) * [0.6, 0.7, 1.2]
    w.fv += (speed * vib)[:, None] * w.noise("grit", 60, 300, 0.5, 3)
    for ax in ([1, 0, 0], [0, 1, 0]):
        w.turn(ax, np.deg2rad(1.0) * np.minimum(speed, 1) * w.noise(f"pitch{ax}", 0.4, 5.0, 1.0))
    for _ in range(g.poisson(dur / 12)):
        b = g.uniform(rest + 2, dur - rest - 3)
        v = speed[int((b + PAD) * fs)]
        if v > 0.1:
            w.shock(b, v * g.uniform(0.3, 1.1), g, g.uniform(12, 40), 0.05)
    w.level(1.0)
    w.Bextra += (0.012 * on * (0.4 + speed))[:, None] * g.normal(size=3)  # motor current
    w.building(0.5)
    w.temperature(temp[0], **temp[1])
    w.marks["speed"] = speed
    w.marks["flex"] = 1
    w.phases = [(0.0, rest - 0.5, "static", "+Z"), (rest, t, "motion", "")] if labels else []
    return w.finish() if finish else w


def pedestrian(
    key, dur, fs=1000, start_c=18.0, hard=1.0, temp=("room", {"drift": -1.0}), rest=6.0, labels=True, finish=True
):
    """A pedestrian carries the box."""
    w = World(key, dur, fs, start_c)
    g = w.r("ped")
    go = smooth_step((w.t - rest) / 1.5) * smooth_step((dur - rest - w.t) / 1.5)
    cad = 1.85 + 0.06 * w.slow("cad", 8.0, 1.0)
    ph = 2 * np.pi * np.cumsum(cad * (go > 0)) / fs
    amp = go * (1 + 0.12 * w.slow("stride", 3.0, 1.0))
    w.a[:, 2] += amp * (2.4 * np.sin(ph) + 0.9 * np.sin(2 * ph + 0.5) + 0.35 * np.sin(3 * ph + 1.0)) * hard
    w.a[:, 0] += amp * (1.2 * np.sin(ph + 1.2) + 0.5 * np.sin(2 * ph)) * hard
    w.a[:, 1] += amp * 0.9 * np.sin(ph / 2 + 0.3) * hard
    step = np.flatnonzero(np.diff(np.floor(ph / (2 * np.pi))) > 0)
    for s in step:
        if amp[s] > 0.3:
            w.shock(w.t[s], 0.28 * hard * amp[s] * g.uniform(0.5, 1.5), g, g.uniform(14, 24), 0.025)
    yaw = np.cumsum(go * w.slow("turnrate", 6.0, 0.35)) / fs
    w.turn([0, 0, 1], yaw)
    w.turn([0, 1, 0], np.deg2rad(3) * amp * np.sin(ph + 0.4) + np.deg2rad(4) * go * w.slow("p", 5.0, 1.0))
    w.turn([1, 0, 0], np.deg2rad(4) * amp * np.sin(ph / 2) + np.deg2rad(4) * go * w.slow("rr", 5.0, 1.0))
    w.tremor(go, 0.15, 0.1)
    w.level(0.8)
    w.building(0.5)
    w.temperature(temp[0], **temp[1])
    w.phases = (
        [(0.0, rest - 0.5, "static", "+Z"), (rest, dur - rest, "motion", ""), (dur - rest + 1, dur, "static", "+Z")]
        if labels
        else []
    )
    return w.finish() if finish else w


def boat(key, dur, fs=400, start_c=16.0, temp=("sun", {"dT": 4.0}), finish=True):
    """A moored boat with a running engine."""
    w = World(key, dur, fs, start_c)
    g = w.r("boat")
    for i, (ax, f, d) in enumerate((([1, 0, 0], 0.19, 6.0), ([0, 1, 0], 0.23, 2.5))):
        w.turn(ax, np.deg2rad(d) * w.noise(f"wave{i}", f * 0.75, f * 1.3, 1.0))
    w.turn([0, 0, 1], np.deg2rad(8) * w.slow("yaw", 20.0, 1.0))
    w.a[:, 2] += w.noise("heave", 0.14, 0.28, 0.5)
    w.a[:, :2] += w.noise("surge", 0.14, 0.4, 0.15, 2)
    ph = 2 * np.pi * np.cumsum(27.5 + 0.4 * w.slow("rpm", 10.0, 1.0)) / fs
    for k, a in ((1, 0.08), (2, 0.05), (3, 0.02)):
        w.fv += (a * np.sin(k * ph + g.uniform(0, 6)))[:, None] * g.normal(size=3)
    w.fv += w.noise("slap", 4, 60, 0.05, 3)
    w.level(2.0)
    w.wind(0.01)
    w.temperature(temp[0], **temp[1])
    w.phases = [(0.0, dur, "motion", "")]
    return w.finish() if finish else w


def elevator(key, dur, fs=500, start_c=22.0, finish=True):
    """An elevator goes up and down."""
    w = World(key, dur, fs, start_c)
    g = w.r("lift")
    t, v = 10.0, np.zeros(w.n)
    floor = 0
    while t < dur - 18:
        n = int(g.integers(1, 5)) * (1 if floor < 2 or g.random() < 0.4 else -1)
        if floor + n < 0 or floor + n > 7:
            n = -n
        floor += n
        h, vm = 3.2 * n, 1.4
        T = max(abs(h) / vm, 2.4)
        a = 2.2
        v += np.sign(h) * (abs(h) / T) * smooth_step((w.t - t) / a) * smooth_step((t + T + a - w.t) / a)
        w.marks.setdefault("rides", []).append((t, t + T + a))
        t += T + a + g.uniform(6, 14)
    w.a[:, 2] += np.gradient(v, 1 / fs)
    mov = np.abs(v)
    w.fv += mov[:, None] * w.noise("rail", 5, 40, 0.035, 3)
    w.fv += (mov > 0.05)[:, None] * (0.02 * np.sin(2 * np.pi * 24.3 * w.t))[:, None] * [0.3, 0.2, 1]
    w.turn([1, 0, 0], np.deg2rad(0.02) * mov * w.noise("sw", 0.5, 2, 1.0))
    w.level(0.4)
    w.building(2.0)
    w.P -= 12.0 * np.cumsum(v) / fs
    w.temperature("room")
    w.phases = [(0.0, 9.0, "static", "+Z"), (9.5, dur - 6, "motion", "")]
    return w.finish() if finish else w


def turntable(
    key,
    rates,
    hold=8.0,
    face="z_up",
    fs=500,
    start_c=23.0,
    off=0.04,
    temp=("warmup", {"dT": 2.0}),
    reference=True,
    finish=True,
):
    """A turntable turns at these rates (dps), with an encoder as reference."""
    g = stream(*key, "world", "tt")
    tp, rp, t, ph = [-PAD, 6.0], [0, 0], 6.0, [(0.0, 5.5, "static", UP[face])]
    for r in rates:
        t += 1.5 + abs(r - rp[-1]) / 150
        tp.append(t)
        rp.append(r)
        ph.append((t + 0.5, t + hold - 0.2, "rate", UP[face]))
        t += hold
        tp.append(t)
        rp.append(r)
    t += 2.5
    tp.append(t)
    rp.append(0)
    dur = t + 6.0
    tp.append(dur + PAD)
    rp.append(0)
    w = World(key, dur, fs, start_c)
    om = np.deg2rad(lag(lag(np.interp(w.t, tp, rp), fs, 0.12), fs, 0.08))
    om *= 1 + 0.0006 * w.slow("motor", 2.0, 1.0)
    psi = np.cumsum(om) / fs
    wob = np.deg2rad(0.04)
    tiltq = of_vectors(np.stack([wob * np.cos(psi), wob * np.sin(psi), 0 * psi], 1))
    w.q = product(product(tiltq, about([0, 0, 1], psi)), np.tile(FACE[face], (w.n, 1)))
    w.level(0.25)
    x = off * np.stack([np.cos(psi), np.sin(psi)], 1)
    w.a[:, :2] += -(om[:, None] ** 2) * x + np.gradient(om, 1 / fs)[:, None] * np.stack([-x[:, 1], x[:, 0]], 1)
    w.fv += (np.abs(om) > 0.02)[:, None] * w.noise("belt", 10, 60, 0.02, 3)
    w.building()
    w.temperature(temp[0], **temp[1])
    w.phases = ph
    w.finish()
    if reference:
        fr = 50.0
        tr = np.arange(0.02, dur - 0.05, 1 / fr)
        ref = w.at(w.w, tr) + np.deg2rad(0.01) * g.standard_normal((len(tr), 3))
        w.reference = {"time": tr, "angular_rate": ref}
    return w


def swing(key, dur, fs=800, start_c=22.0, length_m=1.0, amp=28.0, rest=5.0, finish=True, labels=True):
    """The box hangs on a pendulum of `length_m`."""
    w = World(key, dur, fs, start_c)
    f = np.sqrt(G0 / length_m) / 2 / np.pi
    u = w.t - rest
    th = np.deg2rad(amp) * np.exp(-np.maximum(u, 0) / 45.0) * np.sin(2 * np.pi * f * u) * smooth_step(u / 2.0)
    th += np.deg2rad(0.012) * w.noise("flex", 2, 6, 1.0) * smooth_step(u / 2)
    w.turn([0, 1, 0], th)
    w.turn([1, 0, 0], np.deg2rad(3) * smooth_step(u / 3) * np.sin(2 * np.pi * f * 1.13 * u))
    p = np.stack([-length_m * np.sin(th), 0 * th, length_m * (1 - np.cos(th))], 1)
    w.a += np.gradient(np.gradient(p, 1 / fs, axis=0), 1 / fs, axis=0)
    w.level(1.0)
    w.building(1.0)
    w.temperature("room")
    w.phases = [(0.0, rest - 0.5, "static", "+Z"), (rest, dur, "motion", "")] if labels else []
    return w.finish() if finish else w


def car(key, dur, fs=800, start_c=14.0, temp=("exp", {"start": 12.0, "to": 22.0, "tau": 240.0}), finish=True):
    """A car in a town."""
    w = World(key, dur, fs, start_c)
    g = w.r("car")
    t, tp, vp = 12.0, [-PAD, 12.0], [0, 0]
    while t < dur - 20:
        v = g.choice([0, 6, 9, 13.5], p=[0.25, 0.2, 0.3, 0.25])
        t += max(2.0, abs(v - vp[-1]) / g.uniform(1.2, 2.5))
        tp.append(t)
        vp.append(v)
        t += g.uniform(4, 16)
        tp.append(t)
        vp.append(v)
    t += 6
    tp += [t, dur + PAD]
    vp += [0, 0]
    v = lag(lag(np.interp(w.t, tp, vp), fs, 0.5), fs, 0.3)
    acc = np.gradient(v, 1 / fs)
    yr = np.clip(w.slow("turns", 5.0, 0.16), -0.4, 0.4) * np.clip(v / 6, 0, 1)
    w.turn([0, 0, 1], np.cumsum(yr) / fs)
    w.turn([0, 1, 0], np.deg2rad(-0.5) * lag(acc, fs, 0.3))
    w.turn([1, 0, 0], np.deg2rad(0.6) * lag(v * yr, fs, 0.3))
    w.turn([0, 1, 0], np.deg2rad(1.2) * w.slow("hill", 15.0, 1.0) * np.clip(v / 3, 0, 1))
    w.fv[:, 0] += acc
    w.fv[:, 1] += v * yr
    s = np.sqrt(v / 10)[:, None]
    w.fv += (
        s * w.noise("body", 0.8, 3.0, 0.35, 3) * [0.3, 0.5, 1.3]
        + s * w.noise("axle", 9, 16, 0.35, 3) * [0.4, 0.5, 1.2]
        + s * w.noise("road", 25, 180, 0.3, 3)
    )
    w.wv += s * w.noise("bodyw", 0.8, 3.0, np.deg2rad(1.2), 3) * [1, 1, 0.3]
    rpm = 13.5 + 1.9 * v + 2 * np.clip(acc, 0, 2)
    ph = 2 * np.pi * np.cumsum(lag(rpm, fs, 0.3)) / fs
    for k, a in ((1, 0.03), (2, 0.12), (4, 0.05)):
        w.fv += (a * np.sin(k * ph + g.uniform(0, 6)))[:, None] * g.normal(size=3)
    w.level(2.0)
    w.P += 35 * w.slow("alt", 40.0, 1.0) + np.clip(v / 10, 0, 2) * w.noise("cabin", 0.1, 3, 4.0)
    w.temperature(temp[0], **temp[1])
    w.marks["flex"] = 1
    w.phases = [(0.0, 11.0, "static", "+Z"), (12.0, t, "motion", "")]
    return w.finish() if finish else w


def putdown(key, dur, fs=800, start_c=22.0, finish=True):
    """Held, put down, fingers stay on the lid for a while, leave; later nudged along the table."""
    w = World(key, dur, fs, start_c)
    g = w.r("pd")
    tilt = np.deg2rad(4)
    t1 = 0.25 * dur
    q = about([1, 0.4, 0], tilt * (1 - smooth_step((w.t - t1 + 1.2) / 1.2)))
    w.q = product(w.q, q)
    h = 0.12 * (1 - smooth_step((w.t - t1 + 1.5) / 1.5))
    w.a[:, 2] += np.gradient(np.gradient(h, 1 / fs), 1 / fs)
    w.shock(t1, 0.5, g)
    w.shock(t1 + 0.12, 0.2, g)
    hold = smooth_step((t1 + 0.2 - w.t) / 0.3)
    w.tremor(hold, 0.6, 0.25)
    t2 = t1 + g.uniform(4, 7)
    fing = (w.t > t1) * smooth_step((t2 - w.t) / 0.4)
    w.turn([g.normal(), g.normal(), 0], np.deg2rad(0.05) * fing * (1 + 0.5 * w.noise("pulse", 0.8, 1.6, 1.0)))
    w.fv += fing[:, None] * w.noise("ft", 7, 12, 0.01, 3)
    creep = np.deg2rad(0.02) * np.exp(-np.maximum(w.t - t2, 0) / 12.0) * (w.t > t2)  # rubber feet settle
    w.turn([1, 0.2, 0], creep)
    t3 = 0.7 * dur
    w.a[:, 0] += 1.2 * (smooth_step((w.t - t3) / 0.15) - smooth_step((w.t - t3 - 0.15) / 0.15)) - 1.2 * (
        smooth_step((w.t - t3 - 0.5) / 0.15) - smooth_step((w.t - t3 - 0.65) / 0.15)
    )
    w.fv += ((w.t > t3) & (w.t < t3 + 0.8))[:, None] * w.noise("scrape", 20, 150, 0.5, 3)
    w.turn([0, 0, 1], np.deg2rad(3) * smooth_step((w.t - t3) / 0.8))
    w.level(0.4)
    w.building(1.0, 1)
    w.temperature("room")
    w.marks["t"] = (t1, t2, t3)
    w.phases = [(0.0, t1 - 1.6, "motion", ""), (t1 + 1.0, dur, "static", "+Z")]
    return w.finish() if finish else w
