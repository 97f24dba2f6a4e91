//! A module of WGSL with the order of its declarations and all names erased.
//!
//! Two modules have the same erased lines if a device computes the same by both, expression by expression. The rules:
//!
//! - Entry points keep their names, and come in the order of these. Bindings, offsets, strides and literals stay.
//! - Functions, global variables, types, constants, local variables and expressions have numbers, in the order in which the
//!   entry points first use them. What no entry point reaches is left out.
//! - An alias is its type, and a constant is its value.
//! - Forwarders are collapsed: a function whose body only hands its own arguments, in their order, on to another function, and
//!   returns what that returns, counts as the other function.

use naga::{
    Arena, Block, Constant, Expression, Function, GlobalVariable, Handle, Literal, LocalVariable, Module,
    Statement, Type, TypeInner,
};
use sha2::{Digest, Sha256};
use std::collections::hash_map::Entry;
use std::collections::{HashMap, VecDeque};

/// A line, and where it stands in the module as it was written.
#[derive(Debug, Clone)]
pub struct Line {
    /// What is compared.
    pub text: String,
    /// For readers alone: the function, and the variable if there is one.
    pub origin: String,
}

/// An erased module.
#[derive(Debug, Clone)]
pub struct Erased {
    /// Its lines.
    pub lines: Vec<Line>,
}

impl Erased {
    /// Erases order and names.
    pub fn of(module: &Module) -> Self {
        let mut eraser = Eraser::new(module);
        let mut entry_points: Vec<_> = module.entry_points.iter().collect();
        entry_points.sort_by(|one, other| one.name.cmp(&other.name));
        for point in entry_points {
            eraser.function = format!("entry point {}", point.name);
            let size = point.workgroup_size;
            eraser.line(format!("entry point {} {:?} {size:?}", point.name, point.stage), "");
            eraser.body(&point.function);
        }
        while let Some(handle) = eraser.waiting.pop_front() {
            let function = &module.functions[handle];
            eraser.function = format!("fn {}", function.name.as_deref().unwrap_or("?"));
            eraser.line(format!("function {}", eraser.functions[&handle]), "");
            eraser.body(function);
        }
        Erased { lines: eraser.lines }
    }

    /// A hash of what is left.
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        self.lines.iter().for_each(|line| hasher.update(format!("{}\n", line.text)));
        hasher.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }

    /// The first lines that differ, with what stands before them; `None` if the modules are the same.
    pub fn first_difference(&self, other: &Erased) -> Option<String> {
        const BEFORE: usize = 3;
        const FROM: usize = 3;
        let same =
            self.lines.iter().zip(&other.lines).take_while(|(one, other)| one.text == other.text).count();
        if same == self.lines.len() && same == other.lines.len() {
            return None;
        }
        let shown = |mark: &str, line: &Line| format!("{mark} {}    // {}\n", line.text, line.origin);
        let begin = same.saturating_sub(BEFORE);
        let mut text: String = self.lines[begin..same].iter().map(|line| shown(" ", line)).collect();
        text.extend(self.lines.iter().skip(same).take(FROM).map(|line| shown("-", line)));
        text.extend(other.lines.iter().skip(same).take(FROM).map(|line| shown("+", line)));
        Some(text)
    }
}

/// The function that a forwarder hands its arguments on to.
fn forwards_to(function: &Function) -> Option<Handle<Function>> {
    let statements: Vec<&Statement> =
        function.body.iter().filter(|statement| !matches!(statement, Statement::Emit(_))).collect();
    let (call, returned) = match statements[..] {
        [call] => (call, None),
        [call, Statement::Return { value }] => (call, *value),
        _ => return None,
    };
    let Statement::Call { function: callee, arguments, result } = call else { return None };
    let own = |(number, argument): (usize, &Handle<Expression>)| matches!(function.expressions[*argument], Expression::FunctionArgument(of) if of as usize == number);
    let hands_on = arguments.len() == function.arguments.len() && arguments.iter().enumerate().all(own);
    (hands_on && *result == returned && function.local_variables.is_empty()).then_some(*callee)
}

struct Eraser<'a> {
    module: &'a Module,
    /// The function that each forwarder counts as.
    forwarded: HashMap<Handle<Function>, Handle<Function>>,
    functions: HashMap<Handle<Function>, usize>,
    waiting: VecDeque<Handle<Function>>,
    globals: HashMap<Handle<GlobalVariable>, usize>,
    /// Types and constants by their text.
    types: HashMap<String, usize>,
    constants: HashMap<String, usize>,
    lines: Vec<Line>,
    /// The function whose lines are written.
    function: String,
}

/// The numbers within one function.
struct Scope<'a> {
    function: &'a Function,
    /// The handles of its expressions by their indices.
    handles: Vec<Handle<Expression>>,
    expressions: HashMap<Handle<Expression>, usize>,
    locals: HashMap<Handle<LocalVariable>, usize>,
}

impl<'a> Eraser<'a> {
    fn new(module: &'a Module) -> Self {
        let mut forwarded: HashMap<Handle<Function>, Handle<Function>> = HashMap::new();
        // A function calls earlier ones alone.
        for (handle, function) in module.functions.iter() {
            if let Some(callee) = forwards_to(function) {
                forwarded.insert(handle, forwarded.get(&callee).copied().unwrap_or(callee));
            }
        }
        Eraser {
            module,
            forwarded,
            functions: HashMap::new(),
            waiting: VecDeque::new(),
            globals: HashMap::new(),
            types: HashMap::new(),
            constants: HashMap::new(),
            lines: Vec::new(),
            function: String::new(),
        }
    }

    fn line(&mut self, text: String, variable: &str) {
        let origin = if variable.is_empty() {
            self.function.clone()
        } else {
            format!("{}: {variable}", self.function)
        };
        self.lines.push(Line { text, origin });
    }

    fn body(&mut self, function: &'a Function) {
        for argument in &function.arguments {
            let ty = self.ty(argument.ty);
            self.line(
                format!("argument {ty} {:?}", argument.binding),
                argument.name.as_deref().unwrap_or_default(),
            );
        }
        if let Some(result) = &function.result {
            let ty = self.ty(result.ty);
            self.line(format!("result {ty} {:?}", result.binding), "");
        }
        let handles = function.expressions.iter().map(|(handle, _)| handle).collect();
        let mut scope = Scope { function, handles, expressions: HashMap::new(), locals: HashMap::new() };
        self.block(&mut scope, &function.body, 1);
    }

    fn block(&mut self, scope: &mut Scope<'a>, block: &'a Block, depth: usize) {
        block.iter().for_each(|statement| self.statement(scope, statement, depth));
    }

    fn statement(&mut self, scope: &mut Scope<'a>, statement: &'a Statement, depth: usize) {
        let indent = " ".repeat(depth);
        match statement {
            Statement::Emit(range) => {
                for handle in range.clone() {
                    let text = self.expression(scope, handle);
                    let number = scope.number(handle);
                    let name = scope.function.named_expressions.get(&handle).cloned().unwrap_or_default();
                    self.line(format!("{indent}%{number} = {text}"), &name);
                }
            }
            Statement::Block(block) => self.block(scope, block, depth),
            Statement::If { condition, accept, reject } => {
                let condition = self.operand(scope, *condition);
                self.line(format!("{indent}if {condition}"), "");
                self.block(scope, accept, depth + 1);
                self.line(format!("{indent}else"), "");
                self.block(scope, reject, depth + 1);
                self.line(format!("{indent}end"), "");
            }
            Statement::Switch { selector, cases } => {
                let selector = self.operand(scope, *selector);
                self.line(format!("{indent}switch {selector}"), "");
                for case in cases {
                    self.line(format!("{indent}case {:?} {}", case.value, case.fall_through), "");
                    self.block(scope, &case.body, depth + 1);
                }
                self.line(format!("{indent}end"), "");
            }
            Statement::Loop { body, continuing, break_if } => {
                self.line(format!("{indent}loop"), "");
                self.block(scope, body, depth + 1);
                self.line(format!("{indent}continuing"), "");
                self.block(scope, continuing, depth + 1);
                let condition = break_if.map(|condition| self.operand(scope, condition));
                self.line(format!("{indent}end, break if {condition:?}"), "");
            }
            Statement::Call { function, arguments, result } => {
                let arguments: Vec<String> =
                    arguments.iter().map(|argument| self.operand(scope, *argument)).collect();
                let callee = self.callee(*function);
                let result = result.map(|result| format!("%{} = ", scope.number(result))).unwrap_or_default();
                let name = self.module.functions[*function].name.clone().unwrap_or_default();
                self.line(format!("{indent}{result}call {callee}({})", arguments.join(", ")), &name);
            }
            // Statements without blocks, whose handles are all of expressions.
            Statement::Break
            | Statement::Continue
            | Statement::Return { .. }
            | Statement::Kill
            | Statement::ControlBarrier(_)
            | Statement::MemoryBarrier(_)
            | Statement::Store { .. }
            | Statement::ImageStore { .. }
            | Statement::Atomic { .. }
            | Statement::ImageAtomic { .. }
            | Statement::WorkGroupUniformLoad { .. }
            | Statement::SubgroupBallot { .. }
            | Statement::SubgroupGather { .. }
            | Statement::SubgroupCollectiveOperation { .. } => {
                let text = self.with_operands(scope, &format!("{statement:?}"));
                self.line(format!("{indent}{text}"), "");
            }
            _ => panic!("the eraser does not know {statement:?}"),
        }
    }

    fn callee(&mut self, handle: Handle<Function>) -> usize {
        let handle = self.forwarded.get(&handle).copied().unwrap_or(handle);
        let next = self.functions.len();
        if let Entry::Vacant(entry) = self.functions.entry(handle) {
            entry.insert(next);
            self.waiting.push_back(handle);
        }
        self.functions[&handle]
    }

    /// An expression as an operand: its number if it was evaluated before, else what it is.
    fn operand(&mut self, scope: &mut Scope<'a>, handle: Handle<Expression>) -> String {
        match scope.expressions.get(&handle) {
            Some(number) => format!("%{number}"),
            None => self.expression(scope, handle),
        }
    }

    fn expression(&mut self, scope: &mut Scope<'a>, handle: Handle<Expression>) -> String {
        let expression = &scope.function.expressions[handle];
        match expression {
            Expression::LocalVariable(local) => self.local(scope, *local),
            Expression::CallResult(_)
            | Expression::AtomicResult { .. }
            | Expression::WorkGroupUniformLoadResult { .. }
            | Expression::SubgroupBallotResult
            | Expression::SubgroupOperationResult { .. } => format!("%{}", scope.number(handle)),
            Expression::Compose { ty, components } => {
                let ty = self.ty(*ty);
                let components: Vec<String> =
                    components.iter().map(|part| self.operand(scope, *part)).collect();
                format!("{ty}({})", components.join(", "))
            }
            _ => match self.constant_expression(expression) {
                Some(text) => text,
                None => self.with_operands(scope, &format!("{expression:?}")),
            },
        }
    }

    /// An expression that refers to other arenas than that of expressions.
    fn constant_expression(&mut self, expression: &Expression) -> Option<String> {
        match expression {
            Expression::Literal(literal) => Some(literal_text(literal)),
            Expression::Constant(constant) => Some(self.constant(*constant)),
            Expression::ZeroValue(ty) => Some(format!("zero {}", self.ty(*ty))),
            Expression::GlobalVariable(global) => Some(self.global(*global)),
            Expression::Override(_) => panic!("the eraser does not know {expression:?}"),
            _ => None,
        }
    }

    fn local(&mut self, scope: &mut Scope<'a>, handle: Handle<LocalVariable>) -> String {
        if let Some(number) = scope.locals.get(&handle) {
            return format!("local {number}");
        }
        let local = &scope.function.local_variables[handle];
        let ty = self.ty(local.ty);
        let init = local.init.map(|init| self.operand(scope, init));
        let number = scope.locals.len();
        scope.locals.insert(handle, number);
        self.line(format!(" local {number}: {ty} = {init:?}"), local.name.as_deref().unwrap_or_default());
        format!("local {number}")
    }

    fn global(&mut self, handle: Handle<GlobalVariable>) -> String {
        if let Some(number) = self.globals.get(&handle) {
            return format!("global {number}");
        }
        let GlobalVariable { name, space, binding, ty, init, .. } = &self.module.global_variables[handle];
        let ty = self.ty(*ty);
        let init = init.map(|init| self.global_expression(init));
        let binding = binding.map(|binding| (binding.group, binding.binding));
        let number = self.globals.len();
        self.globals.insert(handle, number);
        let text = format!("global {number}: {space:?} {binding:?} {ty} = {init:?}");
        self.line(text, name.as_deref().unwrap_or_default());
        format!("global {number}")
    }

    fn constant(&mut self, handle: Handle<Constant>) -> String {
        let Constant { ty, init, .. } = self.module.constants[handle];
        if let Expression::Literal(literal) = &self.module.global_expressions[init] {
            return literal_text(literal);
        }
        let text = format!("{}: {}", self.ty(ty), self.global_expression(init));
        let next = self.constants.len();
        if let Some(number) = self.constants.get(&text) {
            return format!("constant {number}");
        }
        self.constants.insert(text.clone(), next);
        self.line(format!("constant {next}: {text}"), "");
        format!("constant {next}")
    }

    fn global_expression(&mut self, handle: Handle<Expression>) -> String {
        let arena: &Arena<Expression> = &self.module.global_expressions;
        match &arena[handle] {
            Expression::Compose { ty, components } => {
                let ty = self.ty(*ty);
                let components: Vec<String> =
                    components.iter().map(|part| self.global_expression(*part)).collect();
                format!("{ty}({})", components.join(", "))
            }
            Expression::Splat { size, value } => format!("splat {size:?} {}", self.global_expression(*value)),
            other => match self.constant_expression(other) {
                Some(text) => text,
                None => with_handles(&format!("{other:?}"), |index| {
                    let (handle, _) = arena.iter().nth(index).expect("a handle of the arena");
                    self.global_expression(handle)
                }),
            },
        }
    }

    /// A type: written out, but structs and arrays by a number.
    fn ty(&mut self, handle: Handle<Type>) -> String {
        let text = match &self.module.types[handle].inner {
            TypeInner::Struct { members, span } => {
                let members: Vec<String> = members
                    .iter()
                    .map(|member| format!("{} {} {:?}", member.offset, self.ty(member.ty), member.binding))
                    .collect();
                format!("struct of {span}: {}", members.join("; "))
            }
            TypeInner::Array { base, size, stride } => format!("array {} {size:?} {stride}", self.ty(*base)),
            TypeInner::Pointer { base, space } => return format!("pointer {space:?} {}", self.ty(*base)),
            TypeInner::BindingArray { .. } => panic!("the eraser does not know arrays of bindings"),
            inner => return format!("{inner:?}"),
        };
        let next = self.types.len();
        if let Some(number) = self.types.get(&text) {
            return format!("type {number}");
        }
        self.types.insert(text.clone(), next);
        let name = self.module.types[handle].name.clone().unwrap_or_default();
        self.line(format!("type {next}: {text}"), &name);
        format!("type {next}")
    }

    /// The debugging text of an expression or statement whose handles are all of expressions, with these as operands.
    fn with_operands(&mut self, scope: &mut Scope<'a>, text: &str) -> String {
        with_handles(text, |index| {
            let (handle, expression) = scope.at(index);
            let is_result = matches!(
                expression,
                Expression::AtomicResult { .. }
                    | Expression::WorkGroupUniformLoadResult { .. }
                    | Expression::SubgroupBallotResult
                    | Expression::SubgroupOperationResult { .. }
            );
            if is_result { format!("%{}", scope.number(handle)) } else { self.operand(scope, handle) }
        })
    }
}

impl<'a> Scope<'a> {
    fn number(&mut self, handle: Handle<Expression>) -> usize {
        let next = self.expressions.len();
        *self.expressions.entry(handle).or_insert(next)
    }

    fn at(&self, index: usize) -> (Handle<Expression>, &'a Expression) {
        let handle = self.handles[index];
        (handle, &self.function.expressions[handle])
    }
}

/// Debugging text in which what stands for a handle, `[7]`, is replaced.
fn with_handles(text: &str, mut replaced: impl FnMut(usize) -> String) -> String {
    let mut pieces = text.split('[');
    let mut result = pieces.next().unwrap_or_default().to_string();
    for piece in pieces {
        match piece.split_once(']').map(|(inside, rest)| (inside.parse::<usize>(), rest)) {
            Some((Ok(index), rest)) => {
                result += &replaced(index);
                result += rest;
            }
            Some((Err(_), _)) | None => {
                result.push('[');
                result += piece;
            }
        }
    }
    result
}

/// A literal, with every digit that tells it from another.
fn literal_text(literal: &Literal) -> String {
    format!("{literal:?}")
}
