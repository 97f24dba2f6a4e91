//! Rust finds functions, variables, structs and entry points of WGSL by their names. A name that no shader declares would
//! find nothing, and a rule for it would never apply; so each is looked for here.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};

/// The rules of derivatives, each for a function by its name.
const RULES: &str = "program/rewrite/rules.rs";

/// The compilers that rewrite shaders: all words that they quote are names of WGSL, but for [`GENERATED`].
const REWRITING: &str = "program/rewrite/";

/// Words that the compilers give to what they make, or that begin such a name.
const GENERATED: [&str; 8] =
    ["Adjoints", "adjoint", "Record", "record", "sums_of_adjoints", "_back", "_backward", "df64_"];

/// Names that stand in no shader file, because the host writes the text that declares them.
const COMPOSED: [(&str, &str); 6] = [
    ("divide", "gpu/rounding.rs"),
    ("measure", "engine/rates.rs"),
    ("test", "engine/df64_test.rs"),
    ("NUM_TANGENTS", "derivatives/wgsl.rs"),
    ("Numbers", "program/layout/numbers.rs"),
    ("trace_hot_path", "cpu/path/compose.rs"),
];

/// What WGSL declares.
#[derive(Debug, Default)]
struct Declared {
    functions: BTreeSet<String>,
    /// Functions, and all else that has a name in a module: variables, constants, structs and their members.
    all: BTreeSet<String>,
}

impl Declared {
    fn add(&mut self, text: &str) {
        let word = |text: &str| -> String {
            text.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect()
        };
        for line in text.lines().map(|line| line.split("//").next().unwrap().trim()) {
            // Attributes stand before names: `@group(0) @binding(1) var<storage> table: ...`.
            for (keyword, is_function) in
                [("fn ", true), ("struct ", false), ("const ", false), ("alias ", false), ("var<", false)]
            {
                let Some(at) = line.find(keyword) else { continue };
                let rest = &line[at + keyword.len()..];
                let rest =
                    if keyword == "var<" { rest.split_once("> ").map_or("", |(_, rest)| rest) } else { rest };
                self.all.insert(word(rest));
                if is_function {
                    self.functions.insert(word(rest));
                }
            }
            if let Some((member, _)) = line.split_once(':')
                && word(member) == member
            {
                self.all.insert(member.to_string());
            }
        }
    }
}

/// The words that a file quotes outside its tests, and those by which it finds something in a module of naga.
#[derive(Debug, Default)]
struct Quoted {
    all: BTreeSet<String>,
    found_by: BTreeSet<String>,
}

impl Quoted {
    fn of(text: &str) -> Self {
        let mut quoted = Quoted::default();
        quoted.visit_file(&syn::parse_file(text).unwrap());
        quoted
    }

    fn find_by(&mut self, expression: Option<&syn::Expr>) {
        if let Some(syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(name), .. })) = expression {
            self.found_by.insert(name.value());
        }
    }
}

impl<'ast> Visit<'ast> for Quoted {
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}

    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if module.ident != "tests" {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_lit_str(&mut self, text: &'ast syn::LitStr) {
        let word = text.value();
        if !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            self.all.insert(word);
        }
    }

    /// `StructLayout::of(module, "Range")`, `stride_of(program, "Range")`, `pipeline("advance", ...)`.
    fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
        if let syn::Expr::Path(syn::ExprPath { path, .. }) = &*call.func {
            let names: Vec<String> = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            match names.as_slice() {
                [.., "StructLayout", "of"] | [.., "stride_of"] => self.find_by(call.args.last()),
                [.., "pipeline"] | [.., "FirstStage", "new"] => self.find_by(call.args.first()),
                _ => {}
            }
        }
        visit::visit_expr_call(self, call);
    }

    /// `gpu.pipeline("advance", ...)`.
    fn visit_expr_method_call(&mut self, call: &'ast syn::ExprMethodCall) {
        if call.method == "pipeline" {
            self.find_by(call.args.first());
        }
        visit::visit_expr_method_call(self, call);
    }

    /// `fn entry_point(&self) -> &str`.
    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        if function.sig.ident == "entry_point" {
            let mut inner = Quoted::default();
            visit::visit_block(&mut inner, &function.block);
            self.found_by.append(&mut inner.all);
        }
        visit::visit_impl_item_fn(self, function);
    }

    /// `variable.name.as_deref() == Some("queue_in")`.
    fn visit_expr_binary(&mut self, comparison: &'ast syn::ExprBinary) {
        let is_of_name = |expression: &syn::Expr| match expression {
            syn::Expr::MethodCall(call) => {
                let is_name = |field: &syn::ExprField| matches!(&field.member, syn::Member::Named(member) if member == "name");
                call.method == "as_deref" && matches!(&*call.receiver, syn::Expr::Field(f) if is_name(f))
            }
            _ => false,
        };
        if let (true, syn::Expr::Call(some)) = (is_of_name(&comparison.left), &*comparison.right) {
            self.find_by(some.args.first());
        }
        visit::visit_expr_binary(self, comparison);
    }

    /// `entry_point: "trace_new".into()`.
    fn visit_field_value(&mut self, field: &'ast syn::FieldValue) {
        let is_entry_point = matches!(&field.member, syn::Member::Named(member) if member == "entry_point");
        if let (true, syn::Expr::MethodCall(call)) = (is_entry_point, &field.expr) {
            self.find_by(Some(&call.receiver));
        }
        visit::visit_field_value(self, field);
    }
}

/// Files in a folder of the repository and below it, by their paths in it, with their text.
fn files(folder: &str, extension: &str) -> Vec<(String, String)> {
    fn add(root: &Path, folder: &Path, extension: &str, files: &mut Vec<(String, String)>) {
        let mut paths: Vec<PathBuf> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        for path in paths {
            if path.is_dir() {
                add(root, &path, extension, files);
            } else if path.extension().is_some_and(|found| found == extension) {
                let name = path.strip_prefix(root).unwrap().to_str().unwrap().replace('\\', "/");
                files.push((name, std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut found = Vec::new();
    add(&root, &root, extension, &mut found);
    found
}

fn declared() -> Declared {
    let mut declared = Declared::default();
    files("shaders", "wgsl").iter().for_each(|(_, text)| declared.add(text));
    declared
}

/// Names that no shader declares, each with the file of Rust that quotes it.
fn undeclared(file: &str, text: &str, declared: &Declared) -> Vec<String> {
    let quoted = Quoted::of(text);
    let is_composed = |name: &str| COMPOSED.iter().any(|(composed, _)| *composed == name);
    let is_rewritten = |name: &str| {
        GENERATED.contains(&name)
            || declared.all.contains(name)
            || declared.all.contains(&format!("df64_{name}"))
    };
    let found_by = quoted.found_by.iter().filter(|name| !declared.all.contains(*name) && !is_composed(name));
    let rewriting = quoted.all.iter().filter(|name| match file {
        RULES => !declared.functions.contains(*name),
        _ => file.starts_with(REWRITING) && !is_rewritten(name) && !is_composed(name),
    });
    let names: BTreeSet<&String> = found_by.chain(rewriting).collect();
    names.into_iter().map(|name| format!("{file}: {name}")).collect()
}

#[test]
fn every_name_by_which_rust_finds_something_in_wgsl_is_declared_there() {
    let declared = declared();
    let missing: Vec<String> =
        files("src", "rs").iter().flat_map(|(file, text)| undeclared(file, text, &declared)).collect();
    assert_eq!(missing, Vec::<String>::new(), "no shader declares them");
}

/// The names that are looked for are seen at all: rules, structs, entry points, variables.
#[test]
fn names_are_found_wherever_rust_quotes_them() {
    let all = files("src", "rs");
    let quoted = |file: &str| {
        let (_, text) = all.iter().find(|(name, _)| name == file).unwrap_or_else(|| panic!("no {file}"));
        Quoted::of(text)
    };
    let rules = quoted(RULES).all;
    assert!(
        rules.len() > 20
            && ["nearest_primitive", "cos_real", "recalled_hit"].iter().all(|n| rules.contains(*n))
    );
    let of_device = quoted("engine/device.rs").found_by;
    assert!(["Range", "Event", "queue_in"].iter().all(|name| of_device.contains(*name)), "{of_device:?}");
    let of_stages = quoted("engine/stages.rs").found_by;
    assert!(["trace_new", "trace_queued", "advance"].iter().all(|n| of_stages.contains(*n)), "{of_stages:?}");
    for (name, file) in COMPOSED {
        let (_, text) = all.iter().find(|(found, _)| found == file).unwrap_or_else(|| panic!("no {file}"));
        assert!(text.contains(name), "{file} composes no {name}");
    }
}

#[test]
fn a_name_that_no_shader_declares_is_noticed() {
    let declared = declared();
    let all = files("src", "rs");
    let planted = |file: &str, old: &str, new: &str| {
        let (_, text) = all.iter().find(|(name, _)| name == file).unwrap_or_else(|| panic!("no {file}"));
        assert!(text.contains(old), "{file} has no {old}");
        undeclared(file, &text.replacen(old, new, 1), &declared)
    };
    assert_eq!(
        planted(RULES, "\"is_number\"", "\"deposit_loss_of_value\""),
        [format!("{RULES}: deposit_loss_of_value")]
    );
    // A variable is no function.
    assert_eq!(planted(RULES, "\"is_number\"", "\"kept_events\""), [format!("{RULES}: kept_events")]);
    let names = "program/rewrite/transpose/names.rs";
    assert_eq!(planted(names, "\"last_hit\"", "\"latest_hit\""), [format!("{names}: latest_hit")]);
    let device = "engine/device.rs";
    assert_eq!(planted(device, "\"Event\"", "\"Evnt\""), [format!("{device}: Evnt")]);
    assert_eq!(
        planted(device, "Some(\"queue_in\")", "Some(\"queue_inn\")"),
        [format!("{device}: queue_inn")]
    );
    let stages = "engine/stages.rs";
    assert_eq!(
        planted(stages, "\"trace_queued\"", "\"trace_waiting\""),
        [format!("{stages}: trace_waiting")]
    );
}
