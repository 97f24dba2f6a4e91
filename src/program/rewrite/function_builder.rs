//! What all rewritings of functions share: new expressions, and the statements that decide and jump. Each rewriting has rules
//! of its own for values, and for what reads and writes them.

use crate::error::Result;
use naga::{
    AtomicFunction, BinaryOperator, Block, Expression, Function, Handle, Literal, Range, Scalar, Span,
    Statement, SwitchCase, Type, UnaryOperator,
};

/// A function that is written.
pub(super) trait FunctionBuilder {
    /// The new function.
    fn new_function(&mut self) -> &mut Function;

    /// A new expression, which is evaluated elsewhere.
    fn append(&mut self, expression: Expression) -> Handle<Expression> {
        self.new_function().expressions.append(expression, Span::UNDEFINED)
    }

    /// A new expression that is evaluated here.
    fn emit(&mut self, expression: Expression, out: &mut Block) -> Handle<Expression> {
        let value = self.append(expression);
        out.push(Statement::Emit(Range::new_from_bounds(value, value)), Span::UNDEFINED);
        value
    }

    fn binary(
        &mut self,
        op: BinaryOperator,
        left: Handle<Expression>,
        right: Handle<Expression>,
        out: &mut Block,
    ) -> Handle<Expression> {
        self.emit(Expression::Binary { op, left, right }, out)
    }

    fn negated(&mut self, expr: Handle<Expression>, out: &mut Block) -> Handle<Expression> {
        self.emit(Expression::Unary { op: UnaryOperator::Negate, expr }, out)
    }

    fn select(
        &mut self,
        condition: Handle<Expression>,
        accept: Handle<Expression>,
        reject: Handle<Expression>,
        out: &mut Block,
    ) -> Handle<Expression> {
        self.emit(Expression::Select { condition, accept, reject }, out)
    }

    /// Calls a function of the new module, and gives its result.
    fn call_for_result(
        &mut self,
        function: Handle<Function>,
        arguments: Vec<Handle<Expression>>,
        out: &mut Block,
    ) -> Handle<Expression> {
        let value = self.append(Expression::CallResult(function));
        out.push(Statement::Call { function, arguments, result: Some(value) }, Span::UNDEFINED);
        value
    }
}

/// A function that is written anew, statement by statement, from an old one.
pub(super) trait Rewrite: FunctionBuilder {
    /// The new value of an old one that has been emitted, or that needs no evaluation.
    fn value(&mut self, old: Handle<Expression>) -> Result<Handle<Expression>>;

    /// Appends what an old statement becomes.
    fn statement(&mut self, statement: &Statement, out: &mut Block) -> Result<()>;

    fn values(&mut self, old: &[Handle<Expression>]) -> Result<Vec<Handle<Expression>>> {
        old.iter().map(|old| self.value(*old)).collect()
    }

    fn optional(&mut self, old: Option<Handle<Expression>>) -> Result<Option<Handle<Expression>>> {
        old.map(|old| self.value(old)).transpose()
    }

    fn block(&mut self, block: &Block) -> Result<Block> {
        let mut out = Block::new();
        for statement in block.iter() {
            self.statement(statement, &mut out)?;
        }
        Ok(out)
    }

    /// The type of the new module in the place of an old one.
    fn new_type(&mut self, old: Handle<Type>) -> Result<Handle<Type>> {
        Ok(old)
    }

    /// An expression that is evaluated, with new values in the place of those it takes; none of any other expression.
    fn with_new_operands(&mut self, old: &Expression) -> Result<Option<Expression>> {
        Ok(Some(match *old {
            Expression::Compose { ty, ref components } => {
                Expression::Compose { ty: self.new_type(ty)?, components: self.values(components)? }
            }
            Expression::Splat { size, value } => Expression::Splat { size, value: self.value(value)? },
            Expression::Swizzle { size, vector, pattern } => {
                Expression::Swizzle { size, vector: self.value(vector)?, pattern }
            }
            Expression::Access { base, index } => {
                Expression::Access { base: self.value(base)?, index: self.value(index)? }
            }
            Expression::AccessIndex { base, index } => {
                Expression::AccessIndex { base: self.value(base)?, index }
            }
            Expression::Load { pointer } => Expression::Load { pointer: self.value(pointer)? },
            Expression::ArrayLength(array) => Expression::ArrayLength(self.value(array)?),
            Expression::Relational { fun, argument } => {
                Expression::Relational { fun, argument: self.value(argument)? }
            }
            Expression::Unary { op, expr } => Expression::Unary { op, expr: self.value(expr)? },
            Expression::Binary { op, left, right } => {
                Expression::Binary { op, left: self.value(left)?, right: self.value(right)? }
            }
            Expression::Select { condition, accept, reject } => Expression::Select {
                condition: self.value(condition)?,
                accept: self.value(accept)?,
                reject: self.value(reject)?,
            },
            Expression::Math { fun, arg, arg1, arg2, arg3 } => Expression::Math {
                fun,
                arg: self.value(arg)?,
                arg1: self.optional(arg1)?,
                arg2: self.optional(arg2)?,
                arg3: self.optional(arg3)?,
            },
            Expression::As { expr, kind, convert } => {
                Expression::As { expr: self.value(expr)?, kind, convert }
            }
            _ => return Ok(None),
        }))
    }

    /// What a statement becomes that decides, jumps or waits; none of any other statement.
    fn control(&mut self, statement: &Statement) -> Result<Option<Statement>> {
        Ok(Some(match statement {
            Statement::Block(block) => Statement::Block(self.block(block)?),
            Statement::If { condition, accept, reject } => Statement::If {
                condition: self.value(*condition)?,
                accept: self.block(accept)?,
                reject: self.block(reject)?,
            },
            Statement::Switch { selector, cases } => Statement::Switch {
                selector: self.value(*selector)?,
                cases: cases
                    .iter()
                    .map(|case| Ok(SwitchCase { body: self.block(&case.body)?, ..case.clone() }))
                    .collect::<Result<_>>()?,
            },
            Statement::Loop { body, continuing, break_if } => Statement::Loop {
                body: self.block(body)?,
                continuing: self.block(continuing)?,
                break_if: self.optional(*break_if)?,
            },
            Statement::Break
            | Statement::Continue
            | Statement::Kill
            | Statement::ControlBarrier(_)
            | Statement::MemoryBarrier(_) => statement.clone(),
            _ => return Ok(None),
        }))
    }

    /// What an atomic does, with the new value that it compares with.
    fn atomic_function(&mut self, old: &AtomicFunction) -> Result<AtomicFunction> {
        Ok(match old {
            AtomicFunction::Exchange { compare: Some(compare) } => {
                AtomicFunction::Exchange { compare: Some(self.value(*compare)?) }
            }
            other => *other,
        })
    }
}

/// A number as a literal of the reals' width.
pub(super) fn real_literal(real: Scalar, value: f64) -> Expression {
    Expression::Literal(match real.width {
        8 => Literal::F64(value),
        _ => Literal::F32(value as f32),
    })
}

/// The blocks within a statement.
pub(super) fn inner_blocks(statement: &Statement) -> Box<dyn Iterator<Item = &Block> + '_> {
    match statement {
        Statement::Block(block) => Box::new(std::iter::once(block)),
        Statement::If { accept, reject, .. } => Box::new([accept, reject].into_iter()),
        Statement::Switch { cases, .. } => Box::new(cases.iter().map(|case| &case.body)),
        Statement::Loop { body, continuing, .. } => Box::new([body, continuing].into_iter()),
        _ => Box::new(std::iter::empty()),
    }
}

/// The same, to be changed.
pub(super) fn inner_blocks_mut(statement: &mut Statement) -> Box<dyn Iterator<Item = &mut Block> + '_> {
    match statement {
        Statement::Block(block) => Box::new(std::iter::once(block)),
        Statement::If { accept, reject, .. } => Box::new([accept, reject].into_iter()),
        Statement::Switch { cases, .. } => Box::new(cases.iter_mut().map(|case| &mut case.body)),
        Statement::Loop { body, continuing, .. } => Box::new([body, continuing].into_iter()),
        _ => Box::new(std::iter::empty()),
    }
}

/// The functions that a block calls.
pub(super) fn called(block: &Block) -> Vec<Handle<Function>> {
    let of = |statement: &Statement| match statement {
        Statement::Call { function, .. } => vec![*function],
        other => inner_blocks(other).flat_map(called).collect(),
    };
    block.iter().flat_map(of).collect()
}
