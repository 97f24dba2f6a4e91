//! Reads the expression of `--where`, such as `reflections == 2 and not scattered(mount)`, with the names of a scene.
//!
//! ```text
//! expression = term { "or" term }            term = factor { "and" factor }
//! factor     = "not" factor | "(" expression ")" | count comparison number | question "(" NAME ")" | sequence("...")
//! ```
//!
//! A name stands for a surface, such as `L1.front`, or for a component with all its surfaces. Names that are no plain
//! words are quoted, and `*` stands for any characters in quotes.

use crate::error::{Error, Result};
use crate::model::key_path::{did_you_mean, quoted, ticked};
use crate::model::path_filter::{
    Count, Events, MOST_MARKS, MOST_PARTS, MOST_PATTERNS, Mark, Part, PathFilter, Pattern, Relation, Term,
};
use crate::model::{SceneIr, StepKind};

/// Questions about single events, which take a name.
const QUESTIONS: [&str; 7] = ["hit", "reflected", "transmitted", "scattered", "source", "first", "last"];

/// Words that stand between others.
const JOINTS: [&str; 3] = ["and", "or", "not"];

impl PathFilter {
    /// Reads an expression.
    ///
    /// # Errors
    /// [`Error::Usage`] with the column, what is wrong there, and what would be right.
    pub fn parse(text: &str, ir: &SceneIr) -> Result<PathFilter> {
        let tokens = tokens(text)?;
        let mut reader =
            Reader { text, ir, tokens, at: 0, marks: Vec::new(), patterns: Vec::new(), depth: 0 };
        let root = reader.expression()?;
        if let Some(token) = reader.tokens.get(reader.at) {
            let problem = format!("{} is not expected", token.shown());
            return Err(reader.error(token.column, &problem, "join two conditions by `and` or `or`"));
        }
        Ok(PathFilter { text: text.trim().to_string(), root, marks: reader.marks, patterns: reader.patterns })
    }
}

#[derive(Debug, Clone, PartialEq)]
enum Kind {
    Word(String),
    Quoted(String),
    Number(String),
    Sign(&'static str),
}

#[derive(Debug, Clone)]
struct Token {
    kind: Kind,
    /// From 1 on.
    column: usize,
}

impl Token {
    fn shown(&self) -> String {
        match &self.kind {
            Kind::Word(text) | Kind::Number(text) => ticked(text),
            Kind::Quoted(text) => quoted(text),
            Kind::Sign(sign) => ticked(sign),
        }
    }
}

fn error(text: &str, column: usize, problem: &str, remedy: &str) -> Error {
    Error::Usage(format!("--where {}: column {column}: {problem}; {remedy}", quoted(text)))
}

fn tokens(text: &str) -> Result<Vec<Token>> {
    let chars: Vec<char> = text.chars().collect();
    let mut tokens = Vec::new();
    let mut at = 0;
    while at < chars.len() {
        let (start, first) = (at, chars[at]);
        let column = start + 1;
        let run = |is_of: fn(char) -> bool| chars[start..].iter().take_while(|c| is_of(**c)).count();
        let kind = match first {
            c if c.is_whitespace() => {
                at += 1;
                continue;
            }
            '"' | '\'' => {
                let Some(length) = chars[start + 1..].iter().position(|c| *c == first) else {
                    return Err(error(
                        text,
                        column,
                        "a quoted name has no end",
                        "close it by the same quote",
                    ));
                };
                at += length + 2;
                Kind::Quoted(chars[start + 1..start + 1 + length].iter().collect())
            }
            c if c.is_ascii_digit() => {
                at += run(|c| c.is_alphanumeric() || c == '.' || c == '_');
                Kind::Number(chars[start..at].iter().collect())
            }
            c if c.is_alphabetic() || c == '_' => {
                at += run(|c| c.is_alphanumeric() || matches!(c, '.' | '_' | '-' | '[' | ']'));
                Kind::Word(chars[start..at].iter().collect())
            }
            _ => {
                let rest: String = chars[start..].iter().take(2).collect();
                let signs = Relation::ALL.iter().map(|(sign, _)| *sign).chain(["(", ")"]);
                let Some(sign) = signs.into_iter().find(|sign| rest.starts_with(sign)) else {
                    let remedy = match first {
                        '=' => "two are equal by `==`",
                        '&' => "join two conditions by `and`",
                        '|' => "join two conditions by `or`",
                        '!' => "deny a condition by `not`",
                        '*' => "quote a name with `*`, as in hit(\"L1.*\")",
                        _ => "names that are no plain words are quoted",
                    };
                    return Err(error(
                        text,
                        column,
                        &format!("{} is not known", ticked(&first.to_string())),
                        remedy,
                    ));
                };
                at += sign.len();
                Kind::Sign(sign)
            }
        };
        tokens.push(Token { kind, column });
    }
    Ok(tokens)
}

struct Reader<'a> {
    text: &'a str,
    ir: &'a SceneIr,
    tokens: Vec<Token>,
    at: usize,
    marks: Vec<Mark>,
    patterns: Vec<Pattern>,
    depth: usize,
}

/// Most brackets and `not` within each other.
const DEEPEST: usize = 100;

impl Reader<'_> {
    fn error(&self, column: usize, problem: &str, remedy: &str) -> Error {
        error(self.text, column, problem, remedy)
    }

    /// The column after the last character.
    fn end(&self) -> usize {
        self.text.chars().count() + 1
    }

    fn next(&mut self, expected: &str) -> Result<Token> {
        let Some(token) = self.tokens.get(self.at).cloned() else {
            return Err(self.error(
                self.end(),
                "the expression ends here",
                &format!("{expected} is expected"),
            ));
        };
        self.at += 1;
        Ok(token)
    }

    fn takes(&mut self, word: &str) -> bool {
        let is_it = |token: &Token| match &token.kind {
            Kind::Word(known) => known == word,
            Kind::Sign(sign) => *sign == word,
            Kind::Quoted(_) | Kind::Number(_) => false,
        };
        let is_next = self.tokens.get(self.at).is_some_and(is_it);
        self.at += usize::from(is_next);
        is_next
    }

    fn expression(&mut self) -> Result<Term> {
        let mut terms = vec![self.term()?];
        while self.takes("or") {
            terms.push(self.term()?);
        }
        Ok(if terms.len() == 1 { terms.remove(0) } else { Term::Any(terms) })
    }

    fn term(&mut self) -> Result<Term> {
        let mut factors = vec![self.factor()?];
        while self.takes("and") {
            factors.push(self.factor()?);
        }
        Ok(if factors.len() == 1 { factors.remove(0) } else { Term::All(factors) })
    }

    fn factor(&mut self) -> Result<Term> {
        self.depth += 1;
        let factor = self.shallow_factor();
        self.depth -= 1;
        factor
    }

    fn shallow_factor(&mut self) -> Result<Term> {
        let token = self.next("a condition, such as `reflections == 2`,")?;
        if self.depth > DEEPEST {
            return Err(self.error(
                token.column,
                "the expression is nested too deeply",
                "write it with fewer brackets",
            ));
        }
        match &token.kind {
            Kind::Sign("(") => {
                let inner = self.expression()?;
                self.closes(token.column)?;
                Ok(inner)
            }
            Kind::Word(word) if word == "not" => Ok(Term::Not(Box::new(self.factor()?))),
            Kind::Word(word) if word == "sequence" => self.sequence(),
            Kind::Word(word) if QUESTIONS.contains(&word.as_str()) => self.question(word),
            Kind::Word(word) => match Count::ALL.iter().find(|(name, _)| name == word) {
                Some((name, count)) => self.comparison(name, *count),
                None => {
                    let counts = Count::ALL.iter().map(|(name, _)| *name);
                    let known: Vec<&str> =
                        counts.chain(QUESTIONS).chain(["sequence"]).chain(JOINTS).collect();
                    let remedy = did_you_mean(word, known);
                    Err(self.error(token.column, &format!("{} is not known", ticked(word)), &remedy))
                }
            },
            Kind::Quoted(_) | Kind::Number(_) | Kind::Sign(_) => Err(self.error(
                token.column,
                &format!("{} is not expected", token.shown()),
                "a condition begins by a word, such as `reflections == 2` or `hit(L1.front)`",
            )),
        }
    }

    fn closes(&mut self, opened: usize) -> Result<()> {
        match self.takes(")") {
            true => Ok(()),
            false => Err(self.error(opened, "`(` is not closed", "write `)` where it ends")),
        }
    }

    fn comparison(&mut self, name: &str, count: Count) -> Result<Term> {
        let sign = self.next("a comparison, such as `== 2`,")?;
        let known = Relation::ALL.iter().find(|(known, _)| sign.kind == Kind::Sign(known));
        let Some((_, comparison)) = known else {
            let remedy = format!("compare, as in `{name} == 2`; known here: == != < <= > >=");
            return Err(self.error(sign.column, &format!("{} is no comparison", sign.shown()), &remedy));
        };
        let number = self.next("a whole number")?;
        let value = match &number.kind {
            Kind::Number(text) => text.parse::<u32>().ok(),
            Kind::Word(_) | Kind::Quoted(_) | Kind::Sign(_) => None,
        };
        let Some(value) = value else {
            let remedy = format!("{name} are counted: give a whole number, such as 2");
            return Err(self.error(
                number.column,
                &format!("{} is no whole number", number.shown()),
                &remedy,
            ));
        };
        Ok(Term::Compare(count, *comparison, value))
    }

    /// What stands in brackets behind a word.
    fn argument(&mut self, word: &str, example: &str) -> Result<Token> {
        let opened = self.next("`(`")?;
        if opened.kind != Kind::Sign("(") {
            return Err(self.error(
                opened.column,
                &format!("`(` is expected behind `{word}`"),
                &format!("write {example}"),
            ));
        }
        let argument = self.next("a name")?;
        if matches!(argument.kind, Kind::Sign(_)) {
            return Err(self.error(
                argument.column,
                &format!("{} is no name", argument.shown()),
                &format!("write {example}"),
            ));
        }
        self.closes(opened.column)?;
        Ok(argument)
    }

    fn question(&mut self, word: &str) -> Result<Term> {
        let example = if word == "source" { "source(NAME)" } else { "a surface, as in hit(L1.front)" };
        let argument = self.argument(word, example)?;
        let (Kind::Word(name) | Kind::Quoted(name) | Kind::Number(name)) = &argument.kind else {
            return Err(self.error(argument.column, "a name is expected", &format!("write {example}")));
        };
        let mark = match word {
            "source" => Mark::Source(self.sources(name, argument.column)?),
            _ => {
                let surfaces = self.surfaces(name, argument.column)?;
                let events =
                    |kinds: &[StepKind]| Events { kinds: kinds.to_vec(), surfaces: surfaces.clone() };
                match word {
                    "reflected" => Mark::Some(events(&[StepKind::Reflected])),
                    "transmitted" => Mark::Some(events(&[StepKind::Transmitted])),
                    "scattered" => Mark::Some(events(&[StepKind::ScatteredThrough, StepKind::ScatteredBack])),
                    "first" => Mark::First(events(&StepKind::ALL)),
                    "last" => Mark::Last(events(&StepKind::ALL)),
                    _ => Mark::Some(events(&StepKind::ALL)),
                }
            }
        };
        if let Some(known) = self.marks.iter().position(|known| *known == mark) {
            return Ok(Term::Marked(known));
        }
        if self.marks.len() == MOST_MARKS {
            let remedy =
                format!("at most {MOST_MARKS} questions fit; a component or `*` names many surfaces at once");
            return Err(self.error(argument.column, "there are too many questions", &remedy));
        }
        self.marks.push(mark);
        Ok(Term::Marked(self.marks.len() - 1))
    }

    fn sequence(&mut self) -> Result<Term> {
        const EXAMPLE: &str = "sequence(\"lamp > * > R L1.back > * > image\")";
        let argument = self.argument("sequence", EXAMPLE)?;
        let Kind::Quoted(pattern) = &argument.kind else {
            return Err(self.error(argument.column, "a sequence is quoted", &format!("write {EXAMPLE}")));
        };
        let mut parts: Vec<Part> = Vec::new();
        // The column of the part, behind the quote.
        let mut column = argument.column + 1;
        for text in pattern.split('>') {
            let part =
                self.part(text.trim(), parts.is_empty(), column + text.len() - text.trim_start().len())?;
            if !(part == Part::Anything && parts.last() == Some(&Part::Anything)) {
                parts.push(part);
            }
            column += text.chars().count() + 1;
        }
        if parts.len() > MOST_PARTS {
            let remedy = format!("at most {MOST_PARTS} fit; `*` stands for any number of parts");
            return Err(self.error(argument.column, "the sequence has too many parts", &remedy));
        }
        self.check_order(&parts, argument.column)?;
        self.patterns.push(Pattern(parts));
        if self.patterns.len() > MOST_PATTERNS {
            return Err(self.error(
                argument.column,
                "there are too many sequences",
                &format!("at most {MOST_PATTERNS} fit into one expression"),
            ));
        }
        Ok(Term::Matches(self.patterns.len() - 1))
    }

    /// A source comes first alone, and a detector last. A pattern that begins or ends otherwise would match nothing.
    fn check_order(&self, parts: &[Part], column: usize) -> Result<()> {
        let last = parts.len() - 1;
        let remedy = "a sequence goes from a source or `*` to a detector or `*`, as in \"lamp > * > image\"";
        for (at, part) in parts.iter().enumerate() {
            let problem = match part {
                Part::Source(_) if at > 0 => "a source stands within a sequence",
                Part::Detector(_) if at < last => "a detector stands within a sequence",
                Part::Step(_) if at == 0 => "the sequence begins at a surface",
                Part::Step(_) | Part::Source(_) if at == last => "the sequence ends at no detector",
                Part::Anything | Part::Source(_) | Part::Step(_) | Part::Detector(_) => continue,
            };
            return Err(self.error(column, problem, remedy));
        }
        Ok(())
    }

    /// A part of a sequence. Where a source and a detector share a name, the first part is the source.
    fn part(&self, text: &str, is_first: bool, column: usize) -> Result<Part> {
        if text == "*" {
            return Ok(Part::Anything);
        }
        if text.is_empty() {
            return Err(self.error(
                column,
                "a part of the sequence is empty",
                "write `*` for any number of parts",
            ));
        }
        let step = text.split_once(char::is_whitespace).and_then(|(letters, name)| {
            let kinds: Vec<StepKind> = match letters {
                "*" => StepKind::ALL.to_vec(),
                _ => StepKind::ALL.into_iter().filter(|kind| kind.letters() == letters).collect(),
            };
            (!kinds.is_empty()).then(|| (kinds, name.trim()))
        });
        if let Some((kinds, name)) = step {
            let offset = text.chars().count() - name.chars().count();
            return Ok(Part::Step(Events { kinds, surfaces: self.surfaces(name, column + offset)? }));
        }
        let sources = matching(text, self.ir.sources.iter().map(|source| source.name.as_str()));
        let detectors = matching(text, self.ir.detectors.iter().map(|detector| detector.name.as_str()));
        match (sources.is_empty(), detectors.is_empty()) {
            (false, true) => Ok(Part::Source(sources)),
            (true, false) => Ok(Part::Detector(detectors)),
            (false, false) if is_first => Ok(Part::Source(sources)),
            (false, false) => Ok(Part::Detector(detectors)),
            (true, true) => {
                let sources = self.ir.sources.iter().map(|source| source.name.as_str());
                let known = sources.chain(self.ir.detectors.iter().map(|detector| detector.name.as_str()));
                let remedy = match matching_surfaces(text, self.ir).is_empty() {
                    false => format!(
                        "say what happened there: `T {text}`, `R {text}`, `ST {text}`, `SR {text}` or `* {text}`"
                    ),
                    true => did_you_mean(text, known),
                };
                let problem = format!("{} is no source and no detector", ticked(text));
                Err(self.error(column, &problem, &remedy))
            }
        }
    }

    fn sources(&self, name: &str, column: usize) -> Result<Vec<u32>> {
        let names = self.ir.sources.iter().map(|source| source.name.as_str());
        let found = matching(name, names.clone());
        if found.is_empty() {
            let problem = format!("{} is no source", ticked(name));
            return Err(self.error(column, &problem, &did_you_mean(name, names)));
        }
        Ok(found)
    }

    fn surfaces(&self, name: &str, column: usize) -> Result<Vec<u32>> {
        let found = matching_surfaces(name, self.ir);
        if !found.is_empty() {
            return Ok(found);
        }
        let problem = format!("{} is no surface and no component", ticked(name));
        let is_detector = self.ir.detectors.iter().any(|detector| detector.name == name);
        let remedy = match is_detector {
            true => "passing a detector is no event; --detector picks a detector".to_string(),
            false => {
                let surfaces: Vec<String> =
                    (0..self.ir.surfaces.len()).map(|surface| self.ir.surface_name(surface)).collect();
                let components = surfaces.iter().filter_map(|name| Some(name.rsplit_once('.')?.0));
                let mut known: Vec<&str> = components.chain(surfaces.iter().map(String::as_str)).collect();
                known.dedup();
                did_you_mean(name, known)
            }
        };
        Err(self.error(column, &problem, &remedy))
    }
}

/// The numbers of the names that a name or a pattern stands for.
fn matching<'a>(pattern: &str, names: impl Iterator<Item = &'a str>) -> Vec<u32> {
    (0..).zip(names).filter(|(_, name)| glob(pattern, name)).map(|(number, _)| number).collect()
}

/// The surfaces of a name: its own, or all of a component.
fn matching_surfaces(pattern: &str, ir: &SceneIr) -> Vec<u32> {
    let is_it = |surface: &u32| is_surface_of(pattern, &ir.surface_name(*surface as usize));
    (0..ir.surfaces.len() as u32).filter(is_it).collect()
}

/// True if a pattern stands for the surface of this name, or for its component.
pub(crate) fn is_surface_of(pattern: &str, name: &str) -> bool {
    glob(pattern, name) || name.rsplit_once('.').is_some_and(|(component, _)| glob(pattern, component))
}

/// True if a text is one for which a pattern stands: `*` is any characters.
pub(crate) fn glob(pattern: &str, text: &str) -> bool {
    let mut pieces = pattern.split('*');
    let Some(rest) = text.strip_prefix(pieces.next().unwrap_or_default()) else { return false };
    let pieces: Vec<&str> = pieces.collect();
    let Some((last, middle)) = pieces.split_last() else { return rest.is_empty() };
    let mut rest = rest;
    for piece in middle {
        let Some(at) = rest.find(piece) else { return false };
        rest = &rest[at + piece.len()..];
    }
    rest.len() >= last.len() && rest.ends_with(last)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::model::{End, Sequence, Step};

    fn ir() -> SceneIr {
        crate::Scene::from_path("scenes/cooke_triplet.json".as_ref()).unwrap().lower().unwrap()
    }

    fn sequence(ir: &SceneIr, steps: &[(StepKind, &str)]) -> Sequence {
        let surface = |name: &str| (0..).zip(&ir.surfaces).find(|(_, s)| s.name == name).unwrap().0;
        let steps = steps.iter().map(|&(kind, name)| Step { kind, surface: surface(name) }).collect();
        Sequence { source: 2, steps, end: End::Detector(0) }
    }

    #[test]
    fn expressions_hold_for_the_sequences_they_describe() {
        use StepKind::{Reflected as R, ScatteredBack as SR, Transmitted as T};
        let ir = ir();
        let ghost = sequence(
            &ir,
            &[
                (T, "L1.front"),
                (R, "L1.back"),
                (R, "L1.front"),
                (T, "L1.back"),
                (SR, "L3.edge"),
                (T, "L3.front"),
            ],
        );
        for (text, expected) in [
            ("reflections == 2", true),
            ("reflections != 2", false),
            ("reflections < 3 and scatterings >= 1", true),
            ("transmissions > 3", false),
            ("events <= 6", true),
            ("events == 5", false),
            ("hit(L3)", true),
            ("hit(L5)", false),
            ("hit(L5) or hit(\"L3.*\")", true),
            ("reflected(L1.front)", true),
            ("reflected(L3)", false),
            ("transmitted(L3)", true),
            ("scattered(L3.edge) and not scattered(L1)", true),
            ("first(L1)", true),
            ("first(L3)", false),
            ("last(L3.front)", true),
            ("last(L1)", false),
            ("source(star_2)", true),
            ("source('star_*')", true),
            ("source(star_1)", false),
            ("sequence(\"*\")", true),
            ("sequence(\"star_2 > * > image\")", true),
            ("sequence(\"star_2 > image\")", false),
            ("sequence(\"* > R L1.back > R L1.front > * > image\")", true),
            ("sequence(\"* > R L1 > * > R L1 > *\")", true),
            ("sequence(\"* > R L1 > * > R L1 > * > R L1 > *\")", false),
            (
                "sequence(\"* > * L1.front > R L1.back > R L1.front > T L1.back > SR L3.* > T L3 > image\")",
                true,
            ),
            ("sequence(\"* > T L3.front > stray\")", false),
            ("not (reflections == 2 and (hit(L5) or events > 9))", true),
        ] {
            let filter = PathFilter::parse(text, &ir).unwrap();
            assert_eq!(filter.keeps(&ghost), expected, "{text}");
        }
    }

    #[test]
    fn mistakes_have_their_place_and_a_remedy() {
        let ir = ir();
        for (text, place, remedy) in [
            ("reflektions == 2", "column 1", "did you mean `reflections`?"),
            ("reflections = 2", "column 13", "`==`"),
            ("reflections 2", "column 13", "compare, as in"),
            ("reflections == two", "column 16", "whole number"),
            ("reflections == 2.5", "column 16", "whole number"),
            ("reflections == 2 hit(L1)", "column 18", "`and` or `or`"),
            ("reflections == 2 && hit(L1)", "column 18", "`and`"),
            ("hit(L1.fornt)", "column 5", "did you mean `L1.front`?"),
            ("hit(image)", "column 5", "passing a detector is no event"),
            ("hit L1", "column 5", "hit(L1.front)"),
            ("hit(L1", "column 4", "`)`"),
            ("(hit(L1)", "column 1", "`)`"),
            ("source(stra_1)", "column 8", "did you mean `star_1`?"),
            ("", "column 1", "is expected"),
            ("not", "column 4", "is expected"),
            ("hit('L1)", "column 5", "quote"),
            ("sequence(L1)", "column 10", "quoted"),
            ("sequence(\"star_1 > L1.front > image\")", "column 20", "say what happened there"),
            ("sequence(\"star_1 > T L9.front > image\")", "column 22", "L1"),
            ("sequence(\"star_1 > > image\")", "column 20", "`*`"),
            ("sequence(\"T L1.front > image\")", "column 10", "from a source"),
            ("sequence(\"star_1 > T L1.front\")", "column 10", "from a source"),
            ("sequence(\"* > imgae\")", "column 15", "did you mean `image`?"),
        ] {
            let message = PathFilter::parse(text, &ir).unwrap_err().to_string();
            assert!(message.contains(&format!("{place}:")), "{text}: {message}");
            assert!(message.contains(remedy), "{text}: {message}");
        }
        let nested = "(".repeat(100_000) + "events == 1";
        assert!(PathFilter::parse(&nested, &ir).unwrap_err().to_string().contains("too deeply"));
    }

    #[test]
    fn stars_stand_for_any_characters() {
        for (pattern, text, expected) in [
            ("*", "", true),
            ("a*b", "ab", true),
            ("a*b", "a..b", true),
            ("a*b", "a..bc", false),
            ("*a*", "bab", true),
            ("a*a", "a", false),
            ("ab", "abc", false),
            ("L*.f*t", "L1.front", true),
        ] {
            assert_eq!(glob(pattern, text), expected, "{pattern} {text}");
        }
    }
}
