"""Parts of the published scripts."""

MOVES = [[0, 2], [0, 1], [2, 1], [0, 2], [1, 0], [1, 2], [0, 2]]

# The published towers are those after the move, since the authors' `move` changes them in place;
# here a row sees the towers before its move.
AFTER = [
    [[3, 2], [], [1]],
    [[3], [2], [1]],
    [[3], [2, 1], []],
    [[], [2, 1], [3]],
    [[1], [2], [3]],
    [[1], [], [3, 2]],
    [[], [], [3, 2, 1]],
]

TOWERS = [[[3, 2, 1], [], []], *AFTER[:-1]]

STEPS = [{"mov": mov, "tower": tower} for mov, tower in zip(MOVES, TOWERS, strict=True)]

CONFIGS = [
    {f"config{level}": [mov, tower]}
    for level, (mov, tower) in enumerate(zip(MOVES, TOWERS, strict=True), 1)
]

HANOI = {
    """# Basic recursive query
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT mov.this
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]], level=1                # the local level variable
CONNECT BY tower = move(mov.this, tower), level=level+1    # is required to prevent
STOP WITH  level==7 or []==move(mov.this, tower)           # an infinite recursion

AS list; """: [MOVES],
    """# Recursive query with no cycles allowed ... reduces the search space
# because one moves can be applied a couple of times, the tower is included as
# an additional result parameter
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT mov.this, tower
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]], level=1
CONNECT BY NO CYCLE
           tower = move( mov.this, tower ), level=level+1
STOP WITH  level==7 or [] == move( mov.this, tower )

AS dict; """: [STEPS],
    """# a result can only appear once in a search, note the changed SELECT-statement
# the "to" function is used to format/name the titles in the dictionary
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT to([mov.this, tower], "config"+str(level))
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]], level=1
CONNECT BY UNIQUE
           tower = move( mov.this, tower ), level=level+1
STOP WITH  level==7 or [] == move( mov.this, tower )

AS dict; """: [CONFIGS],
    """# both options can also be applied in combination
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT to([mov.this, tower], "config"+str(level))
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]], level=1
CONNECT BY NO CYCLE UNIQUE
           tower = move( mov.this, tower ), level=level+1
STOP WITH  level==7 or [] == move( mov.this, tower )

AS dict; """: [CONFIGS],
    """# The memorize option generates a graph structure in the background
# with a certain depth, which can speed-up a query ...
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];

SELECT mov.this, tower
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )

START WITH tower = [[3,2,1],[],[]]
CONNECT BY MEMORIZE 
           tower = move( mov.this, tower )
STOP WITH  [] == move( mov.this, tower )

AS dict; """: [[[step] for step in STEPS]],  # noqa: W291
    """# 
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];
              
SELECT mov.this, tower
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )
              
START WITH tower = [[3,2,1],[],[]]
CONNECT BY MEMORIZE 7
           tower = move( mov.this, tower )
STOP WITH  [] == move( mov.this, tower )
              
AS dict; """: [[[step] for step in STEPS]],  # noqa: W291, W293
    """
moves  = [[0,1], [0,2], [1,0], [1,2], [2,0], [2,1]];
              
SELECT to([mov.this, tower], "move"+str(level))
FROM mov=moves
WHERE [[],[],[3,2,1]] == move( mov.this, tower )
              
START WITH tower = [[3,2,1],[],[]], level= 1
CONNECT BY tower = move( mov.this, tower ), level=level+1
STOP WITH  level == 7 or ([] == move( mov.this, tower ))
              
AS dict; """: [  # noqa: W293
        [{key.replace("config", "move"): row for key, row in step.items()} for step in CONFIGS]
    ],
}
