//! Reference arithmetic as simple combinational Verilog: exact integers, then one rounding.
//!
//! It is written from `docs/arithmetic.md` only, in another style than the units (`src/hw/fp/`); it shares nothing with
//! them and is not optimised. Each text is a module `prove_case` around the unit `dut`. Its inputs are the
//! parameters of a case. Its outputs are the resulting operands (`a`, `b`), the unit's result (`y`), the reference
//! result (`expected`), and whether these inputs are a valid case (`legal`).

use crate::float::Format;

/// The declarations at the start of every reference.
fn head(format: Format, inputs: &str) -> String {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    format!(
        "module prove_case (
  input wire clk,
{inputs}
  output wire [{top}:0] a, b, y, expected,
  output wire legal
);
  localparam E = {e};            // exponent bits
  localparam F = {f};            // fraction bits
  localparam BIAS = {bias};
  localparam LAST = {last};      // the greatest exponent of a number
  localparam [E-1:0] ONES = {{E{{1'b1}}}};
  localparam [E+F:0] NAN = {{1'b0, ONES, 1'b1, {{(F-1){{1'b0}}}}}};
",
        top = e + f,
        bias = format.bias(),
        last = (1u64 << e) - 2,
    )
}

/// Rounds an exact magnitude `sum` of `bits` bits, in units of 2^(`unit` − BIAS − F), to `expected`: the leading one
/// moves to the front, and the bits below the significand are compared with one half.
fn round(bits: u32) -> String {
    format!(
        "
  // One rounding, to nearest even, exponent unbounded.
  localparam N = {bits};
  integer i;
  reg [31:0] leading;
  always @* begin
    leading = 0;
    for (i = 0; i < N; i = i + 1) if (exact[i]) leading = i;
  end
  wire [N+F+1:0] front = {{exact, {{(F+2){{1'b0}}}}}} << (N - 1 - leading);
  wire [F:0] kept = front[N+F+1 -: F+1];
  wire [N:0] rest = front[N:0];
  wire [N:0] half = {{1'b1, {{N{{1'b0}}}}}};
  wire up = rest > half | (rest == half & kept[0]);
  wire [F+1:0] rounded = {{1'b0, kept}} + up;
  wire carry = rounded[F+1];
  wire signed [31:0] exponent = unit + leading - F + carry;
  wire [F-1:0] fraction = carry ? rounded[F:1] : rounded[F-1:0];
  wire [E+F:0] number =
    exact == 0 || exponent < 1 ? {{(E+F+1){{1'b0}}}} :
    exponent > LAST ? {{sign, ONES, {{F{{1'b0}}}}}} :
    {{sign, exponent[E-1:0], fraction}};
"
    )
}

/// Sum or difference of two numbers that are neither zero nor infinite nor NaN. The inputs are the lesser exponent, the
/// distance of the exponents, and the operand with the greater exponent.
pub fn sum_of_numbers(format: Format, subtract: bool) -> String {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let shift = (1u32 << e) - 3;
    let bits = f + 1 + shift + 1;
    let inputs = format!(
        "  input wire [{e_top}:0] distance, lesser_exponent,
  input wire a_is_greater, a_sign, b_sign,
  input wire [{f_top}:0] a_fraction, b_fraction,",
        e_top = e - 1,
        f_top = f - 1,
    );
    head(format, &inputs)
        + &format!(
            "
  wire [E:0] greater_exponent = lesser_exponent + distance;
  assign legal = lesser_exponent != 0 & greater_exponent <= LAST;
  assign a = {{a_sign, a_is_greater ? greater_exponent[E-1:0] : lesser_exponent, a_fraction}};
  assign b = {{b_sign, a_is_greater ? lesser_exponent : greater_exponent[E-1:0], b_fraction}};
  dut dut (.clk(clk), .a(a), .b(b), .y(y));

  // Exact, in units of the lesser operand's last place.
  wire added_sign = b_sign ^ {subtract};
  wire [{top}:0] greater = {{{{({shift}+1){{1'b0}}}}, 1'b1, a_is_greater ? a_fraction : b_fraction}} << distance;
  wire [{top}:0] lesser = {{{{({shift}+1){{1'b0}}}}, 1'b1, a_is_greater ? b_fraction : a_fraction}};
  wire greater_sign = a_is_greater ? a_sign : added_sign;
  wire lesser_sign = a_is_greater ? added_sign : a_sign;
  wire turns = lesser > greater;
  wire [{top}:0] exact =
    greater_sign == lesser_sign ? greater + lesser :
    turns ? lesser - greater : greater - lesser;
  wire sign = greater_sign != lesser_sign & turns ? lesser_sign : greater_sign;
  wire signed [31:0] unit = lesser_exponent;
{round}
  assign expected = number;
endmodule
",
            subtract = if subtract { "1'b1" } else { "1'b0" },
            top = bits - 1,
            round = round(bits),
        )
}

/// Sum or difference with a zero, an infinity or a NaN as an operand.
pub fn sum_of_specials(format: Format, subtract: bool) -> String {
    head(format, &operand_inputs(format))
        + &format!(
            "
  assign a = operand_a;
  assign b = operand_b;
  dut dut (.clk(clk), .a(a), .b(b), .y(y));
{classes}
  wire added_sign = b[E+F] ^ {subtract};
  assign legal = a_zero | b_zero | a_infinite | b_infinite | a_nan | b_nan;
  assign expected =
    a_nan | b_nan | (a_infinite & b_infinite & a[E+F] != added_sign) ? NAN :
    a_infinite ? a :
    b_infinite ? {{added_sign, b[E+F-1:0]}} :
    a_zero & b_zero ? {{(E+F+1){{1'b0}}}} :
    a_zero ? {{added_sign, b[E+F-1:0]}} : a;
endmodule
",
            classes = classes(),
            subtract = if subtract { "1'b1" } else { "1'b0" },
        )
}

/// Checks that every pair of numbers whose exponents differ by less than `distances` is a case of [`sum_of_numbers`]: the operands
/// computed from the parameters of a pair are that pair.
pub fn sum_coverage(format: Format, distances: &str) -> String {
    head(format, &operand_inputs(format))
        + &format!(
            "
  assign a = operand_a;
  assign b = operand_b;
  wire [E-1:0] ea = a[E+F-1:F], eb = b[E+F-1:F];
  wire a_is_greater = ea >= eb;
  wire [E-1:0] lesser_exponent = a_is_greater ? eb : ea;
  wire [E-1:0] distance = a_is_greater ? ea - eb : eb - ea;
  wire [E:0] greater_exponent = lesser_exponent + distance;
  wire [E-1:0] ea_again = a_is_greater ? greater_exponent[E-1:0] : lesser_exponent;
  wire [E-1:0] eb_again = a_is_greater ? lesser_exponent : greater_exponent[E-1:0];
  assign legal = ea != 0 & ea != ONES & eb != 0 & eb != ONES;
  assign y = {{a[E+F], ea_again, a[F-1:0]}};
  wire legal_there = lesser_exponent != 0 & greater_exponent <= LAST & distance < {distances};
  assign expected = legal_there & eb_again == eb ? a : ~a;
endmodule
"
        )
}

fn operand_inputs(format: Format) -> String {
    format!(
        "  input wire [{}:0] operand_a, operand_b,",
        format.width() - 1
    )
}

/// The kinds of the operands. The fraction of a zero is ignored.
fn classes() -> &'static str {
    "  wire a_zero = a[E+F-1:F] == 0;
  wire b_zero = b[E+F-1:F] == 0;
  wire a_infinite = a[E+F-1:F] == ONES & a[F-1:0] == 0;
  wire b_infinite = b[E+F-1:F] == ONES & b[F-1:0] == 0;
  wire a_nan = a[E+F-1:F] == ONES & a[F-1:0] != 0;
  wire b_nan = b[E+F-1:F] == ONES & b[F-1:0] != 0;
"
}

/// The product of all operands.
pub fn product(format: Format) -> String {
    let f = format.fraction_bits();
    head(format, &operand_inputs(format))
        + &format!(
            "
  assign a = operand_a;
  assign b = operand_b;
  assign legal = 1'b1;
  dut dut (.clk(clk), .a(a), .b(b), .y(y));
{classes}
  // Exact, in units of 2^-2F and the product of the operands' powers of two.
  wire [F:0] a_significand = {{1'b1, a[F-1:0]}};
  wire [F:0] b_significand = {{1'b1, b[F-1:0]}};
  wire [2*F+1:0] exact = a_significand * b_significand;
  wire sign = a[E+F] ^ b[E+F];
  wire signed [31:0] unit = a[E+F-1:F] + b[E+F-1:F] - BIAS - F;
{round}
  assign expected =
    a_nan | b_nan | (a_infinite & b_zero) | (a_zero & b_infinite) ? NAN :
    a_infinite | b_infinite ? {{sign, ONES, {{F{{1'b0}}}}}} :
    a_zero | b_zero ? {{(E+F+1){{1'b0}}}} : number;
endmodule
",
            classes = classes(),
            round = round(2 * f + 2),
        )
}

/// The reciprocal of all operands, by a division of integers. The quotient has at least F + 2 bits; the bit below says whether
/// the remainder is zero, which is sufficient for rounding.
pub fn reciprocal(format: Format) -> String {
    let f = format.fraction_bits();
    head(format, &operand_inputs(format))
        + &format!(
            "
  assign a = operand_a;
  assign b = operand_b;
  assign legal = 1'b1;
  dut dut (.clk(clk), .a(a), .y(y));
{classes}
  wire [2*F+2:0] dividend = {{1'b1, {{(2*F+2){{1'b0}}}}}};
  wire [2*F+2:0] significand = {{1'b1, a[F-1:0]}};
  wire [2*F+2:0] quotient = dividend / significand;
  wire [2*F+2:0] remainder = dividend - quotient * significand;
  wire [F+3:0] exact = {{quotient[F+2:0], remainder != 0}};
  wire sign = a[E+F];
  wire signed [31:0] unit = 2*BIAS - a[E+F-1:F] - 3;
{round}
  assign expected =
    a_nan ? NAN :
    a_infinite ? {{(E+F+1){{1'b0}}}} :
    a_zero ? {{a[E+F], ONES, {{F{{1'b0}}}}}} : number;
endmodule
",
            classes = classes(),
            round = round(f + 4),
        )
}

/// A comparison or a choice, for all operands. It compares signed integers with the same order as the numbers.
pub fn relation(format: Format, relation: Relation) -> String {
    let expected = match relation {
        Relation::Less => "{{(E+F){1'b0}}, comparable & key_a < key_b}",
        Relation::LessEqual => "{{(E+F){1'b0}}, comparable & key_a <= key_b}",
        Relation::Equal => "{{(E+F){1'b0}}, comparable & key_a == key_b}",
        Relation::Min => "comparable & key_b < key_a ? b : a",
        Relation::Max => "comparable & key_b > key_a ? b : a",
    };
    head(format, &operand_inputs(format))
        + &format!(
            "
  assign a = operand_a;
  assign b = operand_b;
  assign legal = 1'b1;
  dut dut (.a(a), .b(b), .y(y));
{classes}
  wire signed [E+F:0] size_a = a_zero ? {{(E+F+1){{1'b0}}}} : {{1'b0, a[E+F-1:0]}};
  wire signed [E+F:0] size_b = b_zero ? {{(E+F+1){{1'b0}}}} : {{1'b0, b[E+F-1:0]}};
  wire signed [E+F:0] key_a = a[E+F] ? -size_a : size_a;
  wire signed [E+F:0] key_b = b[E+F] ? -size_b : size_b;
  wire comparable = !(a_nan | b_nan);
  assign expected = {expected};
endmodule
",
            classes = classes(),
        )
}

/// A comparison or a choice between two numbers; a choice has the operands bound and x.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Relation {
    Less,
    LessEqual,
    Equal,
    Min,
    Max,
}

/// Steps by ulps, for all operands, computed with the ranks of the numbers: −0 and +0 have rank 0, the least normal numbers ±1.
pub fn step(format: Format, ulps: i32) -> String {
    head(format, &operand_inputs(format))
        + &format!(
            "
  assign a = operand_a;
  assign b = operand_b;
  assign legal = 1'b1;
  dut dut (.a(a), .y(y));
{classes}
  localparam signed [E+F+1:0] BELOW_LEAST = (1 << F) - 1;
  localparam signed [E+F+1:0] INFINITY = (((1 << E) - 1) << F) - BELOW_LEAST;
  wire signed [E+F+1:0] size = a_zero ? 0 : $signed({{2'b00, a[E+F-1:0]}}) - BELOW_LEAST;
  wire signed [E+F+1:0] rank = a[E+F] ? -size : size;
  wire signed [E+F+1:0] moved = rank + ({ulps});
  wire negative = moved < 0;
  wire signed [E+F+1:0] distance = negative ? -moved : moved;
  wire signed [E+F+1:0] bounded = distance > INFINITY ? INFINITY : distance;
  wire signed [E+F+1:0] pattern = bounded == 0 ? 0 : bounded + BELOW_LEAST;
  assign expected = a[E+F-1:F] == ONES ? a : {{negative, pattern[E+F-1:0]}};
endmodule
",
            classes = classes(),
        )
}
