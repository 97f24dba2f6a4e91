//! The library's files import one way: from rooms that stand before theirs in [`LAYERS`], and never in a circle.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use syn::visit::Visit;

/// The rooms of src/, each of which may import from itself and from those before it. This is the one list of layers.
const LAYERS: [&str; 22] = [
    "format", // numbers and names for people
    "error",  // what can go wrong
    "mesa",
    "folders",
    "placing",
    "random",
    "count",       // the machine's ways
    "gpu",         // wgpu and nothing else
    "shaders",     // the text of the shaders
    "model",       // the scene as traced
    "scene",       // what the user wrote -> model
    "program",     // model -> WGSL and bytes
    "result",      // sums -> maps, ledger, files
    "engine",      // the plain loop
    "guide",       // addition: rays are guided to rare light
    "paths",       // addition: light by its path
    "derivatives", // addition: tangents and adjoints
    "cpu",         // addition: what is done otherwise on processors
    "run",         // a run: tracer, precision, stopping, checkpoints
    "viewer",
    "cli", // whoever calls the library
    "lib",
];

/// A file of the library: its module, and its text.
type Files = BTreeMap<Vec<String>, String>;

/// Which files each file imports from.
type Imports = BTreeMap<Vec<String>, BTreeSet<Vec<String>>>;

fn files() -> Files {
    fn add(folder: &Path, module: &[String], files: &mut Files) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let stem = path.file_stem().unwrap().to_str().unwrap().to_string();
            let inner = [module, std::slice::from_ref(&stem)].concat();
            if path.is_dir() {
                add(&path, &inner, files);
            } else if path.extension().is_some_and(|extension| extension == "rs") && stem != "main" {
                let module = if stem == "mod" || stem == "lib" { module.to_vec() } else { inner };
                files.insert(module, std::fs::read_to_string(&path).unwrap());
            }
        }
    }
    let mut files = Files::new();
    add(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &[], &mut files);
    files
}

/// The paths that a file names, outside of its tests: those of `use`, with the names that they stand for, and all others.
#[derive(Default)]
struct Paths {
    used: Vec<(Vec<String>, String, bool)>,
    others: Vec<Vec<String>>,
}

impl Paths {
    fn of(text: &str) -> Self {
        let mut paths = Paths::default();
        paths.visit_file(&syn::parse_file(text).unwrap());
        paths
    }

    fn add_tree(&mut self, tree: &syn::UseTree, prefix: &[String], is_public: bool) {
        let with = |ident: &syn::Ident| [prefix, &[ident.to_string()]].concat();
        match tree {
            syn::UseTree::Path(path) => self.add_tree(&path.tree, &with(&path.ident), is_public),
            syn::UseTree::Group(group) => {
                group.items.iter().for_each(|item| self.add_tree(item, prefix, is_public));
            }
            syn::UseTree::Name(name) if name.ident == "self" => {
                self.used.push((prefix.to_vec(), prefix.last().unwrap().clone(), is_public));
            }
            syn::UseTree::Name(name) => {
                self.used.push((with(&name.ident), name.ident.to_string(), is_public))
            }
            syn::UseTree::Rename(rename) => {
                self.used.push((with(&rename.ident), rename.rename.to_string(), is_public));
            }
            syn::UseTree::Glob(_) => self.used.push((prefix.to_vec(), "*".into(), is_public)),
        }
    }
}

impl<'ast> Visit<'ast> for Paths {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !module.attrs.iter().any(|attribute| attribute.path().is_ident("cfg")) {
            syn::visit::visit_item_mod(self, module);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        let is_public = !matches!(item.vis, syn::Visibility::Inherited);
        self.add_tree(&item.tree, &[], is_public);
    }

    // `pub(crate)` names no file.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.others.push(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        syn::visit::visit_path(self, path);
    }
}

/// Follows paths to the file that defines what they name.
struct Resolver {
    paths: BTreeMap<Vec<String>, Paths>,
}

impl Resolver {
    fn new(files: &Files) -> Self {
        Resolver { paths: files.iter().map(|(module, text)| (module.clone(), Paths::of(text))).collect() }
    }

    /// From the root of the library, if the path begins within it.
    fn absolute(&self, path: &[String], module: &[String]) -> Option<Vec<String>> {
        let (first, rest) = path.split_first()?;
        let below = |module: &[String], rest: &[String]| [module, rest].concat();
        match first.as_str() {
            "crate" => Some(rest.to_vec()),
            "self" => Some(below(module, rest)),
            "super" => {
                let parent = &module[..module.len() - 1];
                match rest.first().is_some_and(|next| next == "super") {
                    true => self.absolute(rest, parent),
                    false => Some(below(parent, rest)),
                }
            }
            _ => {
                let child = below(module, std::slice::from_ref(first));
                self.paths.contains_key(&child).then(|| below(module, path))
            }
        }
    }

    /// The file in which what the path names is defined, past those that only hand it on.
    fn file_of(&self, path: &[String]) -> Vec<String> {
        let depth = (0..=path.len()).rev().find(|depth| self.paths.contains_key(&path[..*depth])).unwrap();
        let (module, rest) = path.split_at(depth);
        let handed_on = rest.first().and_then(|name| {
            let used = &self.paths[module].used;
            used.iter().find(|(_, known_as, is_public)| *is_public && known_as == name)
        });
        match handed_on.and_then(|(path, ..)| self.absolute(path, module)) {
            Some(path) => self.file_of(&[&path, &rest[1..]].concat()),
            None => module.to_vec(),
        }
    }

    fn imports(&self) -> Imports {
        let of = |(module, paths): (&Vec<String>, &Paths)| {
            let aliases: BTreeMap<&String, &Vec<String>> =
                paths.used.iter().map(|(path, known_as, _)| (known_as, path)).collect();
            let whole = |path: &Vec<String>| match aliases.get(&path[0]) {
                Some(alias) if path.len() > 1 => [alias, &path[1..]].concat(),
                _ => path.clone(),
            };
            // To hand a name on is no import.
            let used = paths.used.iter().filter(|(.., is_public)| !is_public).map(|(path, ..)| path.clone());
            let all = used.chain(paths.others.iter().map(whole));
            let files = all.filter_map(|path| self.absolute(&path, module)).map(|path| self.file_of(&path));
            (module.clone(), files.filter(|file| file != module).collect())
        };
        self.paths.iter().map(of).collect()
    }
}

fn name(module: &[String]) -> String {
    if module.is_empty() { "lib".into() } else { module.join("::") }
}

fn layer(module: &[String]) -> usize {
    let room = module.first().map_or("lib", String::as_str);
    LAYERS.iter().position(|layer| *layer == room).unwrap_or_else(|| panic!("{room} is not in LAYERS"))
}

/// Imports from rooms that stand later in the list.
fn upstream(imports: &Imports) -> Vec<String> {
    let pairs = imports.iter().flat_map(|(from, files)| files.iter().map(move |to| (from, to)));
    pairs
        .filter(|(from, to)| layer(from) < layer(to))
        .map(|(from, to)| format!("{} imports {}", name(from), name(to)))
        .collect()
}

/// Imports that lead back to where they stand: those of files in a circle.
fn circles(imports: &Imports) -> Vec<String> {
    let reached = |from: &Vec<String>| {
        let mut reached = BTreeSet::new();
        let mut ahead = vec![from];
        while let Some(file) = ahead.pop() {
            for import in &imports[file] {
                if reached.insert(import.clone()) {
                    ahead.push(import);
                }
            }
        }
        reached
    };
    let reached: BTreeMap<_, _> = imports.keys().map(|file| (file, reached(file))).collect();
    let pairs = imports.iter().flat_map(|(from, files)| files.iter().map(move |to| (from, to)));
    pairs
        .filter(|(from, to)| reached[to].contains(*from))
        .map(|(from, to)| format!("{} imports {}", name(from), name(to)))
        .collect()
}

#[test]
fn no_file_imports_from_a_later_layer() {
    assert_eq!(upstream(&Resolver::new(&files()).imports()), Vec::<String>::new());
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    assert_eq!(circles(&Resolver::new(&files()).imports()), Vec::<String>::new());
}

#[test]
fn a_wrong_import_is_noticed() {
    let files = files();
    let mut resolver = Resolver::new(&files);
    let mut with = |module: &str, import: &str| {
        let module: Vec<String> = module.split("::").map(str::to_string).collect();
        let text = files.get(&module).unwrap_or_else(|| panic!("no file {module:?}"));
        let planted = Paths::of(&format!("{text}{import}"));
        let right = resolver.paths.insert(module.clone(), planted).unwrap();
        let imports = resolver.imports();
        resolver.paths.insert(module, right);
        imports
    };
    let found = upstream(&with("gpu::compute", "\nuse crate::Tracer;"));
    assert!(found.contains(&"gpu::compute imports run::tracer".to_string()), "{found:?}");
    let found = upstream(&with("model::mesh", "\nfn planted() { crate::scene::Scene::from_json(\"\"); }"));
    assert!(found.contains(&"model::mesh imports scene".to_string()), "{found:?}");
    let found = circles(&with("error", "\nuse crate::folders;\nuse crate::gpu::adapter;"));
    assert!(found.contains(&"error imports gpu::adapter".to_string()), "{found:?}");
}

/// What `make test` leaves out is on the list of `make test-long`, and nothing else is.
#[test]
fn tests_that_are_marked_as_long_are_listed() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mark = concat!("#[ignore = ", "\"long\"]");
    let mut marked = BTreeSet::new();
    let folders = ["tests", "benches/tests"].map(|folder| std::fs::read_dir(root.join(folder)).unwrap());
    for entry in folders.into_iter().flatten() {
        let path = entry.unwrap().path();
        let main = if path.is_dir() { path.join("main.rs") } else { path.clone() };
        if main.extension().is_none_or(|extension| extension != "rs") || !main.is_file() {
            continue;
        }
        let (program, text) =
            (path.file_stem().unwrap().to_str().unwrap(), std::fs::read_to_string(&main).unwrap());
        // Those of a `proptest!` are indented.
        let marked_functions =
            text.split(mark).skip(1).filter_map(|rest| rest.trim_start().strip_prefix("fn "));
        let names = marked_functions.map(|function| function.split('(').next().unwrap());
        marked.extend(names.map(|name| format!("{program} {name}")));
        // Trials that a program makes itself are listed as one.
        marked.extend(text.contains(concat!(".with_ignored", "_flag(")).then(|| format!("{program} *")));
    }
    let list = std::fs::read_to_string(root.join("tests/long.txt")).unwrap();
    let listed: BTreeSet<String> =
        list.lines().filter(|line| !line.starts_with('#')).map(str::to_string).collect();
    assert_eq!(marked, listed);
}
