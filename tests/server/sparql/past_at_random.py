"""Random queries about recorded messages: times in every notation, patterns in every kind of group."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from random import Random

PREFIXES = (
    "PREFIX ros: <https://w3id.org/rosld#> PREFIX xsd: <http://www.w3.org/2001/XMLSchema#> "
    "PREFIX twist: <https://w3id.org/rosld/types/geometry_msgs/msg/Twist#> "
    "PREFIX vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#> "
    "PREFIX string: <https://w3id.org/rosld/types/std_msgs/msg/String#> "
    "PREFIX odom: <https://w3id.org/rosld/types/nav_msgs/msg/Odometry#> "
    "PREFIX cov: <https://w3id.org/rosld/types/geometry_msgs/msg/TwistWithCovariance#> "
    "PREFIX header: <https://w3id.org/rosld/types/std_msgs/msg/Header#> "
    "PREFIX tf: <https://w3id.org/rosld/types/tf2_msgs/msg/TFMessage#> "
    "PREFIX geometry: <https://w3id.org/rosld/types/geometry_msgs/msg/> "
    "PREFIX std: <https://w3id.org/rosld/types/std_msgs/msg/> "
)
_FIELDS = (
    "twist:linear {x}", "twist:linear/vector:x {x}", "twist:linear ?v{n} . ?v{n} vector:y {x}", "string:data {x}",
    "odom:twist/cov:twist/twist:linear/vector:x {x}", "tf:transforms/rdf:rest*/rdf:first {x}", "a geometry:Twist",
    "a ?class{n}", "a std:String", "ros:sequence {x}", "?p{n} {x}", "(twist:linear|string:data) {x}",
    "!ros:received {x}",
    "odom:header/header:stamp/ros:dateTime {x}", "odom:header/header:frame_id {x}", "odom:twist/cov:twist {x}, ?w{n}",
    "odom:twist/cov:twist ?v{n} . ?v{n} twist:angular/vector:x {x}", "twist:linear/vector:x {x} ; a ?class{n}",
    "ros:recordedIn {x}", "^ros:recordedMessage/ros:index {x}", "^ros:recordedMessage ?r{n} . ?r{n} ros:onTopic {x}",
)  # fmt: skip
_AGGREGATES = (
    "COUNT(*)", "COUNT(?m)", "COUNT(DISTINCT ?t)", "MIN(?t)", "MAX(?t)", "MIN(?x1)", "MAX(?x1)", "SUM(?x1)", "AVG(?x1)",
    "SUM(DISTINCT ?x1)", "AVG(DISTINCT ?x1)", "SUM(?x1 + ?x2)", "SUM(?x1) / COUNT(?m)", "AVG(?n1)", "SUM(?n1)",
    "MAX(?t) - MIN(?t)", "SUM(IF(BOUND(?x1), 1, 0))", "AVG(SECONDS(?t))",
)  # fmt: skip
_KEYS = (
    ("?topic", "?topic"), ("?m", "?m"), ("?t", "?t"), ("?x1", "?x1"), ("?topic ?x1", "?topic ?x1"),
    ("(?t > {moment} AS ?late)", "?late"), ("(FLOOR(SECONDS(?t)) AS ?second)", "?second"),
    ("(DATATYPE(?x1) AS ?d)", "?d"),
)  # fmt: skip


class PastMaker:
    """Generator of a query about messages recorded from `start` on, for `seconds`; `now` is the assumed NOW()."""

    def __init__(self, base: str, start: datetime, seconds: float, now: datetime) -> None:
        self._base, self._start, self._seconds, self._now = base, start, seconds, now
        self._random = Random(0)
        self._count = 0

    def query(self, seed: int) -> str:
        """Return a query, the same for the same seed."""
        random = self._random
        random.seed(seed)
        self._count = 0
        group = self._group("?m", "?t", 2)
        form = random.random()
        if form < 0.5:
            return f"{PREFIXES}SELECT {random.choice(['*', '?m ?t', 'DISTINCT ?t ?x1'])} WHERE {group}"
        if form < 0.6:
            return f"{PREFIXES}SELECT {self._aggregates()} WHERE {group} {self._having()}"
        if form < 0.7:
            key, name = random.choice(_KEYS)
            key = key.format(moment=self._constant())
            return f"{PREFIXES}SELECT {name} {self._aggregates()} WHERE {group} GROUP BY {key} {self._having()}"
        if form < 0.78:
            return f"{PREFIXES}ASK {group}"
        if form < 0.85:
            return f"{PREFIXES}CONSTRUCT {{ ?m ros:received ?t ; ros:sequence ?x1 }} WHERE {group}"
        if form < 0.9:
            return f"{PREFIXES}DESCRIBE ?m WHERE {group}"
        direction, limit = random.choice(["ASC", "DESC"]), random.choice([1, 3, 10])
        return f"{PREFIXES}SELECT DISTINCT ?t WHERE {group} ORDER BY {direction}(?t) LIMIT {limit}"

    def first_rows(self, seed: int) -> tuple[str, str]:
        """Return a query for all of its rows, ordered by time or unordered, and an ending that selects the first."""
        random = self._random
        random.seed(seed)
        self._count = 0
        group = self._group("?m", "?t", random.choice([0, 1, 1, 2]))
        order = random.choice(["ORDER BY DESC(?t)", "ORDER BY DESC(?t) ?m", "ORDER BY ?t", "ORDER BY ASC(?t)", ""])
        offset = random.choice(["", "", " OFFSET 3"]) if order else ""
        limit = random.choice([1, 1, 2, 5, 12])
        return f"{PREFIXES}SELECT {random.choice(['*', '?t ?m', 'DISTINCT ?t'])} WHERE {group} {order}", (
            f" LIMIT {limit}{offset}"
        )

    def _number(self) -> int:
        self._count += 1
        return self._count

    def _group(self, message: str, time: str, depth: int) -> str:
        random = self._random
        members = [self._past(message, time)]
        for _ in range(random.choice([0, 1, 1, 2])):
            members.insert(random.choice([0, len(members), len(members)]), self._member(message, time, depth))
        for _ in range(random.choice([0, 1, 1, 2])):
            members.insert(random.randrange(len(members) + 1), f"FILTER({self._test(time)})")
        return "{ " + " ".join(members) + " }"

    def _past(self, message: str, time: str) -> str:
        random = self._random
        topic = random.choice(["?topic", "?topic", "</topics/cmd_vel>", "</topics/chatter>", f"?topic{self._number()}"])
        parts = [f"{topic} ros:past {message} ."]
        if random.random() < 0.85:
            parts.append(f"{message} ros:received {time} .")
        if topic.startswith("?"):
            parts.append(
                random.choice(
                    [
                        "", "", f'{topic} ros:name "/odom" .', f'{topic} ros:name ?name . FILTER(?name = "/cmd_vel")',
                        f"{topic} ros:hasMessageType geometry:Twist .",
                        f"VALUES {topic} {{ </topics/odom> </topics/frames> }}",
                        f"FILTER({topic} IN (</topics/odom>, </topics/chatter>))", f"{topic} a ros:Topic .",
                        f'{topic} ros:name ?name . VALUES ?name {{ "/odom" "/frames" }}',
                        f"BIND(</topics/odom> AS {topic}x)",
                    ]
                )
            )  # fmt: skip
        if random.random() < 0.7:
            parts.append(self._field(message))
        if random.random() < 0.5:
            random.shuffle(parts)
        if random.random() < 0.1:
            return f"{{ {' '.join(parts)} }}"
        return " ".join(parts)

    def _field(self, message: str) -> str:
        number = self._number()
        return f"{message} {self._random.choice(_FIELDS).format(x=f'?x{number}', n=number)} ."

    def _member(self, message: str, time: str, depth: int) -> str:
        random = self._random
        kind = random.choice(
            [
                "OPTIONAL",
                "OPTIONAL",
                "MINUS",
                "FILTER EXISTS",
                "FILTER NOT EXISTS",
                "",
                "UNION",
                "SELECT",
                "BIND",
                "asOf",
                "previous",
                "untied",
            ]
        )
        if kind == "BIND":
            number = self._number()
            return f"BIND({self._moment()} AS ?b{number}) FILTER({time} {random.choice('<>')} ?b{number})"
        if kind in ("asOf", "previous"):
            number = self._number()
            topic = random.choice(["?topic", "</topics/odom>", "</topics/cmd_vel>"])
            at = self._start + timedelta(seconds=random.uniform(-1, self._seconds + 1))
            moment = f'"{at.isoformat().replace("+00:00", "Z")}"^^xsd:dateTime'
            call = f"asOf({topic}, {random.choice([time, time, moment])})"
            call = call if kind == "asOf" else f"previous({message})"
            then = f"{self._field(f'?p{number}')} ?p{number} ros:received ?r{number} ."
            then = random.choice(["", then, then, f"OPTIONAL {{ {then} }}", f"FILTER NOT EXISTS {{ {then} }}"])
            return f"BIND(ros:{call} AS ?p{number}) {then}"
        if kind == "untied":
            return random.choice(
                [
                    "",
                    f"?any ros:received {time} .",
                    "?any string:data ?said .",
                    "OPTIONAL { ?m string:data ?also }",
                    f"</topics/cmd_vel> ros:past/twist:linear/vector:x ?c{self._number()} .",
                ]
            )
        number = self._number()
        other = f"?m{number}" if random.random() < 0.6 else message
        at = random.choice([f"?t{number}", time])
        test = f"FILTER({time} {random.choice(['<', '>', '<=', '='])} {at})" if random.random() < 0.6 else ""
        if depth and random.random() < 0.7:
            inner = self._group(other, at, depth - 1)
        else:
            inner = f"{{ {self._field(message)} }}"
        inner = inner[:-1] + f" {test} }}"
        if kind == "UNION":
            return f"{inner} UNION {{ {self._past(message, time)} }}"
        if kind == "SELECT":
            total = f"{other} (SUM(?x{self._count}) AS ?sum{number})"
            chosen = random.choice([other, f"{other} {at}", f"(MAX({at}) AS ?last{number})", "*", total])
            grouped = f"GROUP BY {other} {self._having()}" if chosen == total else ""
            return f"{{ SELECT {chosen} WHERE {inner} {grouped} }}"
        return f"{kind} {inner}"

    # --- aggregates: numbers are integers, even those that are doubles, so that sums are equal in any order

    def _aggregates(self) -> str:
        random = self._random
        chosen = random.sample(_AGGREGATES, random.choice([1, 2, 3]))
        return " ".join(f"({each} AS ?a{number})" for number, each in enumerate(chosen))

    def _having(self) -> str:
        random = self._random
        if random.random() < 0.5:
            return ""
        return "HAVING " + random.choice(
            [
                f"(COUNT(*) {random.choice('<>')} {random.choice([0, 1, 4, 8, 30])})",
                f"(SUM(?x1) {random.choice('<>')} {random.choice([0, 3, 28])})", "(AVG(?x1) >= 1)",
                f"({random.choice(['MIN', 'MAX'])}(?t) {random.choice('<>')} {self._moment()})",
                f"(COUNT(DISTINCT ?m) > 1 && MAX(?t) - MIN(?t) > {self._duration()})", "(!BOUND(?t))",
                f"(EXISTS {{ ?topic ros:past ?other . ?other ros:received ?when FILTER(?when > {self._constant()}) }})",
            ]
        )  # fmt: skip

    # --- times

    def _test(self, time: str) -> str:
        random = self._random
        chance = random.random()
        if chance < 0.12:
            return f"{self._test(time)} && {self._test(time)}"
        if chance < 0.22:
            return f"{self._test(time)} || {self._test(time)}"
        if chance < 0.27:
            return f"!({self._test(time)})"
        if chance < 0.32:
            return f"({self._test(time)})"
        if chance < 0.42:
            return random.choice(
                [
                    f"BOUND({time})", f"YEAR({time}) > 2000", f'STR({time}) < "3000"', "?x1 > 1", '?x1 = "hello"',
                    f"{time} != {self._constant()}", f"{time} IN ({self._constant()}, {self._constant()})",
                    f"COALESCE({time} > {self._constant()}, true)",
                    f"IF(BOUND({time}), {time} < {self._constant()}, true)",
                    f"{time} NOT IN ({self._constant()})", f"{time} = {self._constant()}", "?x1 < ?x2",
                ]
            )  # fmt: skip
        one, other = time, self._moment()
        if random.random() < 0.25:
            one = f"{time} - {self._duration()}"
        if random.random() < 0.1:
            return f"{one} - {other} {random.choice('<>')} {self._duration()}"
        operator = random.choice(["<", ">", "<=", ">="])
        return f"{one} {operator} {other}" if random.random() < 0.6 else f"{other} {operator} {one}"

    def _moment(self) -> str:
        random = self._random
        chance = random.random()
        if chance < 0.4:
            return self._constant()
        if chance < 0.8:
            back = (self._now - self._start).total_seconds() - random.uniform(-1, self._seconds + 1)
            return f'NOW() - "PT{back:.3f}S"^^xsd:{random.choice(["dayTimeDuration", "duration"])}'
        if chance < 0.9:
            return f"({self._constant()} - {self._duration()})"
        return random.choice(["?t", "?t1", "?t2", "(?t1 - " + self._duration() + ")"])

    def _duration(self) -> str:
        random = self._random
        seconds = random.choice(["0", "0.25", "1", "1.5", "3"])
        spelt = random.choice([f"PT{seconds}S", f"PT0M{seconds}S", f"-PT{seconds}S", f"P0DT0H{seconds}S"])
        return random.choice(
            [f'"{spelt}"^^xsd:dayTimeDuration', f'"{spelt}"^^xsd:duration', f'xsd:dayTimeDuration("{spelt}")']
        )

    def _constant(self) -> str:
        random = self._random
        at = self._start + timedelta(seconds=random.choice([random.uniform(-1, self._seconds + 1), 1.0, 2.0]))
        zone = random.choice([timezone.utc, timezone.utc, timezone(timedelta(hours=5, minutes=30))])
        text = at.astimezone(zone).isoformat().replace("+00:00", "Z")
        return random.choice(
            [
                f'"{text}"^^xsd:dateTime', f'"{text}"^^xsd:dateTime', f'xsd:dateTime("{text}")',
                f'"{text[:19]}"^^xsd:dateTime', f'"{text}"', f'"{text[:10]}"^^xsd:date',
            ]
        )  # fmt: skip


RUN_PREFIXES = (
    "PREFIX battery: <https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#> "
    "PREFIX pose: <https://w3id.org/rosld/types/geometry_msgs/msg/Pose#> "
    "PREFIX pcov: <https://w3id.org/rosld/types/geometry_msgs/msg/PoseWithCovariance#> "
    "PREFIX point: <https://w3id.org/rosld/types/geometry_msgs/msg/Point#> "
)
_NUMBERS = (
    ("battery_state", "battery:percentage ?x ; battery:voltage ?y", "sensor_msgs/msg/BatteryState"),
    ("battery_state", "battery:power_supply_status ?x ; battery:present ?y", "sensor_msgs/msg/BatteryState"),
    ("odom", "odom:pose/pcov:pose/pose:position ?p . ?p point:x ?x ; point:y ?y", "nav_msgs/msg/Odometry"),
    ("odom", "odom:twist/cov:twist ?t1 . ?t1 twist:linear/vector:x ?x ; twist:angular [ vector:z ?y ]", "x"),
    ("cmd_vel", "twist:linear/vector:x ?x . ?m twist:angular/vector:z ?y", "geometry_msgs/msg/Twist"),
)
_OF_RUNS = (
    "COUNT(*)", "COUNT(?m)", "COUNT(?x)", "MIN(?x)", "MAX(?x)", "SUM(?x)", "AVG(?x)", "MIN(?y)", "MAX(?y) - MIN(?x)",
    "MIN(?t)", "MAX(?t)", "SUM(?x) / COUNT(?y)", "COUNT(DISTINCT ?bag)", "IF(MIN(?x) < 0.4, 1, 0)", "COUNT(?bag)",
    "SUM(DISTINCT ?x)", "MAX(DISTINCT ?x)", "MIN(STR(?bag))", "SUM(?x * 2)",
)  # fmt: skip


def of_runs(seed: int, names: list[str], start: datetime, seconds: float) -> str:
    """Return a query that aggregates numbers in recordings made by `tests/runs.py`, with their begin and duration."""
    random = Random(seed)
    topic, fields, kind = random.choice(_NUMBERS)
    parts = [
        f"<topics/{topic}> ros:past ?m ." if random.random() < 0.7 else f'?topic ros:past ?m ; ros:name "/{topic}" .',
        random.choice(["?m ros:recordedIn ?bag .", "?r ros:recordedMessage ?m ; ros:recordedIn ?bag ."]),
        f"?m {fields} .",
        "?m ros:received ?t .",
        random.choice(
            [
                "", "", f'?bag ros:name "{random.choice(names)}" .', "?bag ros:name ?name .",
                f'?bag ros:name ?name . FILTER(?name != "{random.choice(names)}")', "?bag ros:topic ?any .",
                f"VALUES ?bag {{ <bags/{names[0]}/> <bags/{names[-1]}/> }}", "BIND(STR(?bag) AS ?name)",
                f"?m a <https://w3id.org/rosld/types/{kind}> .",
            ]
        ),
    ]  # fmt: skip
    for _ in range(random.choice([0, 0, 1, 2])):
        at = (start + timedelta(seconds=random.uniform(0, seconds))).isoformat().replace("+00:00", "Z")
        test = f'?t {random.choice(["<", ">", "<=", ">="])} "{at}"^^xsd:dateTime'
        number = f"?x {random.choice(['<', '>', '<=', '>=', '='])} {random.choice(['0.4', '0.31', '1', '-3e0', '0'])}"
        parts.append(f"FILTER({random.choice([test, test, f'{test} && {number}', number, f'{number} || {test}'])})")
    chosen = random.sample(_OF_RUNS, random.choice([1, 2, 3]))
    aggregates = " ".join(f"({each} AS ?a{number})" for number, each in enumerate(chosen))
    key = random.choice(["", "?bag", "?bag", "?topic ?bag", "(STR(?bag) AS ?key)"])
    names_of_keys = "?key" if "AS" in key else key
    having = random.choice(["", "", f"HAVING(MIN(?x) {random.choice('<>')} 0.4)", "HAVING(COUNT(*) > 25)"])
    random.shuffle(parts)
    where = " ".join(parts)
    return (
        f"{PREFIXES}{RUN_PREFIXES}"
        f"SELECT {names_of_keys} {aggregates} WHERE {{ {where} }} {f'GROUP BY {key}' if key else ''} {having}"
    )
