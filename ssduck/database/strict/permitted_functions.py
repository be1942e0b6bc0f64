"""DuckDB's functions that statements of strangers may call (`Limits(select_only=True)`).

They compute a value from their arguments. Left out are functions that read or change anything else
(files, settings, sequences, memory addresses, the catalog, the clock of the thread), that run a
text as SQL, and, because no limit stops them, that make a long text or list of a short one (as
`list_reduce` can), or whose time grows with the product of the lengths of two texts (as that of
`levenshtein` and of `json_merge_patch`), with the square of one (as that of a regular expression
that is looked for again and again) or with that of the number of rows (as that of `fill`), or that
hash each element of a list, which takes seconds for a million (as `list_distinct` does). None knows
time zones: DuckDB compares an unknown name with those of all zones, in a time that grows with its
length, and hears nothing meanwhile. `json_contains` is left out, too: DuckDB walks through nested
JSON by recursion there, and 50,000 brackets end the process.
"""

from __future__ import annotations

_OPERATORS = """
!= !__postfix !~~ !~~* % & && * ** + - -> ->> / // < <-> << <= <=> = > >= >> @ ^ ^@ | || ~ ~~
~~* ~~~
"""
# Functions of one or more values, aggregates and window functions.
_FUNCTIONS = """
abs acos acosh add age aggregate any_value apply approx_count_distinct approx_quantile
arbitrary arg_max arg_max_null arg_max_nulls_last arg_min arg_min_null
arg_min_nulls_last argmax argmin array_agg array_aggr array_aggregate array_append array_apply
array_cat array_concat array_contains array_cosine_distance array_cosine_similarity
array_cross_product array_distance array_dot_product array_extract array_filter
array_grade_up array_has array_has_any array_indexof array_inner_product
array_length array_negative_dot_product array_negative_inner_product array_pop_back
array_pop_front array_position array_prepend array_push_back array_push_front
array_reverse array_reverse_sort array_select array_slice array_sort array_to_json array_transform
array_value array_where array_zip ascii asin asinh atan atan2 atanh avg base64 bin
binom bit_and bit_count bit_length bit_or bit_xor bitstring_agg bool_and bool_or
cardinality cbrt ceil ceiling century char_length character_length chr concat concat_ws contains
corr cos cosh cot count count_if count_star countif covar_pop covar_samp cume_dist current_date
current_localtime current_localtimestamp date_add date_diff date_part date_sub
date_trunc datediff datepart datesub datetrunc day dayname dayofmonth dayofweek dayofyear
days_in_month decade decimal_average decimal_division decode degrees dense_rank divide
element_at encode ends_with entropy epoch epoch_ms epoch_ns epoch_us era even exp factorial favg
fdiv filter first first_value flatten floor fmod formatReadableDecimalSize formatReadableSize
format_bytes from_base64 from_binary from_hex fsum gamma gcd gen_random_uuid geomean geometric_mean
get_bit grade_up greatest greatest_common_divisor
group_concat hamming hash hex histogram hour if ilike_escape instr isfinite isinf isnan isodow
isoyear jaccard json_array json_array_length
json_exists json_extract json_extract_path json_extract_path_text json_extract_string
json_group_array json_group_object json_insert json_keys json_object json_quote json_remove
json_replace json_set json_strip_nulls json_type json_valid json_value julian kahan_sum kurtosis
kurtosis_pop lag last last_day last_value lcase lcm lead least least_common_multiple left
left_grapheme len length length_grapheme lgamma like_escape list list_aggr list_aggregate
list_any_value list_append list_apply list_approx_count_distinct list_avg list_bit_and list_bit_or
list_bit_xor list_bool_and list_bool_or list_cat list_concat list_contains list_cosine_distance
list_cosine_similarity list_count list_distance list_dot_product list_element
list_extract list_filter list_first list_grade_up list_has list_has_any
list_indexof list_inner_product list_kurtosis list_kurtosis_pop
list_last list_mad list_max list_median list_min list_negative_dot_product
list_negative_inner_product list_pack list_position list_prepend list_product list_reverse
list_reverse_sort list_select list_sem list_skewness list_slice list_sort list_stddev_pop
list_stddev_samp list_sum list_transform list_value list_var_pop list_var_samp
list_where list_zip listagg ln log log10 log2 lower ltrim mad make_date make_time make_timestamp
make_timestamp_ms make_timestamp_ns make_type map map_contains
map_contains_entry map_contains_value map_entries map_extract map_extract_value
map_keys map_values max max_by md5 md5_number mean median microsecond millennium millisecond min
min_by minute mismatches mod mode month monthname multiply nanosecond nextafter normalized_interval
not_ilike_escape not_like_escape nth_value ntile nullif octet_length ord parse_dirname
parse_formatted_bytes path_join percent_rank pi position pow
power prefix product quantile quantile_cont quantile_disc quarter radians random rank rank_dense
regexp_escape regexp_extract regexp_full_match regexp_matches
regr_avgx regr_avgy regr_count regr_intercept regr_r2 regr_slope regr_sxx
regr_sxy regr_syy reverse right right_grapheme round round_even roundbankers row row_number
row_to_json rtrim second sem set_bit sha1 sha256 sign signbit sin sinh skewness split split_part
sqrt starts_with stddev stddev_pop stddev_samp str_split strftime string_agg
string_split string_to_array strip_accents strlen strpos strptime struct_concat
struct_contains struct_extract struct_extract_at struct_has struct_indexof struct_insert struct_keys
struct_pack struct_position struct_values substr substring substring_grapheme subtract suffix sum
sum_no_overflow sumkahan switch tan tanh time_bucket timezone_hour timezone_minute to_base
to_base64 to_binary to_centuries to_days to_decades to_hex to_hours to_json to_microseconds
to_millennia to_milliseconds to_minutes to_months to_quarters to_seconds to_weeks
to_years today trim trunc try_strptime typeof ucase unbin unhex unicode
union_extract union_tag union_value unnest upper uuid uuid_extract_version
uuidv4 uuidv7 var_pop var_samp variance wavg week weekday weekofyear weighted_avg xor year yearweek
"""

# What to write instead of functions that make a long text of a short one.
INSTEAD = {
    "repeat": "write the text out, or join it: name || name",
    "lpad": "write right('000' || name, 3)",
    "rpad": "write left(name || '   ', 3)",
    "format": "join texts: round(z, 2) || ' m'",
    "printf": "join texts: round(z, 2) || ' m'",
    "replace": "join parts: split_part(name, '_', 1) || '-' || split_part(name, '_', 2)",
}

OPERATORS = frozenset(_OPERATORS.split())
FUNCTIONS = frozenset(_FUNCTIONS.split())
# Aggregates that join texts: DuckDB counts the memory of these for groups of rows, not of lists.
JOINING = frozenset(("group_concat", "listagg", "string_agg"))
# Functions whose second argument is the name of an aggregate.
AGGREGATING = frozenset(
    ("aggregate", "array_aggr", "array_aggregate", "list_aggr", "list_aggregate")
)
# Aggregates that take a fraction or a list of fractions last, and the largest number of these: all
# of them are computed in one step.
QUANTILES = frozenset(("approx_quantile", "quantile", "quantile_cont", "quantile_disc"))
MAX_FRACTIONS = 100
# Aggregates that hash each element of a list in one step, and those that do so of each frame.
HASHING = frozenset(("entropy", "histogram", "mode"))
HASHING_FRAMES = HASHING - {"mode"}
# Functions that hash each element of the shorter of two lists.
HASHING_SHORTER = frozenset(("&&", "array_has_any", "list_has_any"))
# Functions whose second argument is a path in JSON, in which each `*` and `..` may stand for all
# places of those before.
PATHS = frozenset(
    ("->", "->>", "json_exists", "json_extract", "json_extract_path", "json_extract_path_text")
).union(("json_extract_string", "json_keys", "json_array_length", "json_type", "json_value"))
WILDCARDS = ("*", "..")
# Functions whose second argument is a regular expression: their time grows with its length times
# that of the text.
REGULAR = frozenset(
    [
        "regexp_extract",
        "regexp_full_match",
        "regexp_matches",
        "~",
        "!~",
        "~*",
        "!~*",
    ]
)
# Functions whose second argument is a pattern, which take as long, by what a statement says.
LIKES = {
    "~~": "LIKE",
    "!~~": "NOT LIKE",
    "~~*": "ILIKE",
    "!~~*": "NOT ILIKE",
    "~~~": "GLOB",
    "like_escape": "LIKE",
    "not_like_escape": "NOT LIKE",
    "ilike_escape": "ILIKE",
    "not_ilike_escape": "NOT ILIKE",
}
MAX_EXPRESSION = 200
# Words that are functions of these types, unless a column has their name.
ZONED_WORDS = frozenset(("current_time", "current_timestamp"))
# Functions that read a time by a format, and the parts of a format that are a time zone.
READING_TIMES = frozenset(("strptime", "try_strptime"))
ZONES = ("%z", "%Z")
# Types that are left out, and what to use: numbers of any length are read in the square of it,
# deeply nested JSON that becomes a VARIANT ends the process, and texts may name any time zone.
UNBOUNDED_TYPES = {
    "bignum": "DOUBLE or HUGEINT",
    "varint": "DOUBLE or HUGEINT",
    "variant": "JSON",
    "timestamptz": "TIMESTAMP",
    "timestamptz_ns": "TIMESTAMP_NS",
    "timestamp with time zone": "TIMESTAMP",
    "timetz": "TIME",
    "time with time zone": "TIME",
}
# Functions in FROM.
TABLE_FUNCTIONS = frozenset(("generate_series", "json_each", "json_tree", "range", "unnest"))
